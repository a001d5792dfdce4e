"""The short check through REST: machines that are as accepted, and machines of which one thing is changed.

    python benchmarks/service/bench_short_check.py [--small] [--unchanged 50] [--changed 20] [--first-seed 0]

``invid serve`` in a process of its own, the case study behind its virtual bus (``--small``: one axis, two
masses): measured in full and accepted, then checked by ``"mode": "screen"``, each time with noise of its own.
A change is one mass, spring or inertia coupling by 3 to 10 %, or the dry or viscous friction of one motor
halved or at 1.5 to 2.5 times, drawn by its seed and made by ``PATCH /cells/{cell}/simulation``. Exit status 1
where more than one unchanged machine in fifty is not called so, or a changed one is, or a change is said
elsewhere.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "system"))
from service_process import SMALL_CELL, Serving, serving

from invid.config import CellConfig, load_config
from invid_drivers.simulated import CASE_STUDY, truth

SMALL = SMALL_CELL + "  axes: {A1: {friction: {coulomb_Nm: 1.0, viscous_Nms_per_rad: 1.0}}}\n"
FRICTION = ("coulomb_Nm", "viscous_Nms_per_rad")
ALARMS = 0.02
"""Of the unchanged ones: 1 % is promised, and one in fifty says nothing against that."""
LONGEST_S = 1800.0
"""Wall clock of one run on a computer that has other things to do."""


def change(config: CellConfig, seed: int) -> tuple[str, set[str], dict[str, Any]]:
    """Return what is changed in words, where it may be said to be, and the patch of the simulation."""
    rng = np.random.default_rng(seed)
    plant, names = truth(config), [a.name for a in config.axes]
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    kinds = ("mass", "spring", *FRICTION, *(["coupling"] if pairs else []))
    kind, axis = kinds[seed % len(kinds)], int(rng.integers(len(names)))
    up = bool(rng.integers(2))
    small, large = 1 + (1 if up else -1) * rng.uniform(0.03, 0.10), rng.uniform(1.5, 2.5) if up else 0.5
    if kind in FRICTION:
        before = float((config.simulation or {})["axes"][names[axis]]["friction"][kind])
        patch = {"axes": {names[axis]: {"friction": {kind: before * large}}}}
        return f"{names[axis]} {kind} × {large:.2f}", {names[axis]}, patch
    masses, springs = ([np.array(v) for v in vs] for vs in (plant.masses, plant.springs))
    couplings, words, where = np.array(plant.couplings), names[axis], {names[axis]}
    if kind == "coupling":
        i, j = pairs[int(rng.integers(len(pairs)))]
        couplings[[i, j], [j, i]] *= small
        words, where = f"{names[j]}-{names[i]}", {f"{names[j]}-{names[i]}", f"{names[i]}-{names[j]}"}
    else:
        values = (masses if kind == "mass" else springs)[axis]
        values[int(rng.integers(values.size))] *= small
    branches = [
        {"axis": n, "masses": m.tolist(), "springs": k.tolist(), "dampers": list(d)}
        for n, m, k, d in zip(names, masses, springs, plant.dampers, strict=True)
    ]
    shared = [{"between": [names[i], names[j]], "value": float(couplings[i, j])} for i, j in pairs]
    patch = {"plant": {"case_study": None, "branches": branches, "couplings": shared}}
    return f"{words} {kind} × {small:.3f}", where, patch


def checked(service: Serving, patch: dict[str, Any] | None) -> dict[str, Any]:
    """Return the summary of a short check of the cell, as configured or with a change."""
    (cell,) = (c["id"] for c in service.client.get("/api/v1/cells").json()["cells"])
    for body in ({"reset": True}, *([] if patch is None else [{"patch": patch}])):
        service.client.patch(f"/api/v1/cells/{cell}/simulation", json=body).raise_for_status()
    return dict(service.wait(service.start(mode="screen"), "succeeded", timeout=LONGEST_S)["summary"])


def campaign(service: Serving, config: CellConfig, unchanged: range, changed: range) -> bool:
    """Print every machine that was answered wrongly, every change, and the figures; return whether they are
    met."""
    first = service.start()
    service.wait(first, "awaiting_accept", timeout=LONGEST_S)
    service.client.post(f"{first}/actions", json={"type": "accept"}).raise_for_status()
    told = dict.fromkeys(("named", "asks to measure in full", "CALLED UNCHANGED", "ELSEWHERE"), 0)
    for seed in changed:
        words, where, patch = change(config, seed)
        said = checked(service, patch)
        mark = judged(said["screening"]["verdict"], set(said["screening"]["changed"]), where)
        told[mark] += 1
        print(f"  {mark}: {words}: {said['headline']}", flush=True)
    alarms = 0
    for seed in unchanged:
        said = checked(service, None)
        if said["screening"]["verdict"] != "unchanged":
            alarms += 1
            print(f"  alarm {seed}: {said['headline']}", flush=True)
    print(f"{len(changed)} changed: {', '.join(f'{mark} {n}' for mark, n in told.items())}")
    print(f"{len(unchanged)} unchanged: {len(unchanged) - alarms} called so")
    wrong = told["CALLED UNCHANGED"] + told["ELSEWHERE"]
    return not wrong and alarms <= ALARMS * len(unchanged)


def judged(verdict: str, found: set[str], where: set[str]) -> str:
    """Return what became of a change that is ``where``."""
    if found:
        return "named" if found <= where else "ELSEWHERE"
    return "CALLED UNCHANGED" if verdict == "unchanged" else "asks to measure in full"


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--unchanged", type=int, default=50)
    parser.add_argument("--changed", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    given = parser.parse_args()
    text = SMALL if given.small else CASE_STUDY.read_text(encoding="utf-8")
    ranges = [range(given.first_seed, given.first_seed + n) for n in (given.unchanged, given.changed)]
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), cell=text) as service:
        return int(not campaign(service, load_config(Path(folder) / "small.yaml"), *ranges))


if __name__ == "__main__":
    sys.exit(main())
