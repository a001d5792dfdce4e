"""Promises of CONTRACT.md that every document has to keep, read again here."""

from typing import Any

SURE = 3.0
"""Standard deviations from which an identification lists friction among the effects of its model."""


def ruled_out_though_found(document: dict[str, Any], created: str | None) -> list[str]:
    """What a diagnosis of the recording ``created`` then rules out though it, one of its alternatives, or the
    identification of that recording finds it."""

    def key(x: dict[str, Any]) -> tuple[Any, ...]:
        return x["cause"], x["axis"], x.get("element"), x.get("other_axis")

    found = {key(x) for f in document["findings"] for x in (f, *f["alternatives"])}
    model = document["model"]
    own = model["provenance"].get("recorded") == created
    for name, estimate in (model["fit"].get("friction") or {}).items() if own else ():
        value, std = estimate["value"], estimate["std"]
        if value is None or std is None or value <= SURE * std:
            continue
        if name.endswith(".coulomb"):
            found.add(("coulomb_friction", name.removesuffix(".coulomb"), "mass 1", None))
        else:
            axis, _, number = name.rpartition(".viscous")
            found.add(("viscous_friction", axis, f"mass {number.removeprefix('.') or 1}", None))
    return [f"{key(r)} above {r['limit']}" for r in document["ruled_out"] if key(r) in found]
