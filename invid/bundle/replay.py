"""The results of a bundle worked out again from its recording, and every number compared."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from invid.api import diagnose, identify, read_recording
from invid.bundle.archive import Archive, read_archive
from invid.bundle.bundle import ANALYSIS, DIAGNOSIS, ENVIRONMENT, MODEL, RECORDING, environment
from invid.errors import InputError
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import dump_json, model_to_json

NO_RESULT = "provenance.recording"
"""Where a file lay, not what is in it."""


@dataclass(frozen=True)
class Difference:
    """One entry that is not the same: its place, as ``diagnosis.json: findings[0].confidence``."""

    place: str
    bundled: Any
    replayed: Any

    @property
    def sentence(self) -> str:
        """Return the comparison in a sentence for a person."""
        return f"{self.place}: {_short(self.bundled)} in the bundle, {_short(self.replayed)} here"


@dataclass(frozen=True)
class Replay:
    """``numbers`` compared, ``identical`` of them to the last bit; what differs beyond ``tolerance``."""

    signer: str
    trusted: bool
    numbers: int
    identical: int
    tolerance: float
    differences: tuple[Difference, ...]
    packages: tuple[str, ...]
    missing: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The document of ``invid replay --json``."""
        return {
            "signer": self.signer,
            "trusted": self.trusted,
            "numbers": self.numbers,
            "identical": self.identical,
            "tolerance": self.tolerance,
            "differences": [
                {"place": d.place, "bundled": d.bundled, "replayed": d.replayed} for d in self.differences
            ],
            "packages": list(self.packages),
            "missing": list(self.missing),
            "warnings": [d.sentence for d in self.differences[:20]],
        }


def replay(path: Path, *, trust: Path | None = None, tolerance: float = 0.0) -> Replay:
    """Check a bundle and work its results out again; needs no network and no file beside it.

    ``tolerance`` is the relative difference that a number may have, 0: to the last bit, as it is on the same
    kind of processor with the same packages.
    """
    archive = read_archive(path, trust)
    analysis, recording = _analysis(archive, path), archive.parts.get(RECORDING)
    if recording is None:
        raise InputError(f"{path}: {RECORDING}: is missing")
    with tempfile.TemporaryDirectory(prefix="invid-replay-") as folder:
        file = Path(folder) / RECORDING
        file.write_bytes(recording)
        data = replace(read_recording(file), source=RECORDING)
    model = identify(data, masses=analysis.get("masses"), method=analysis.get("method", "refined"))
    diagnosis = diagnose(data, model=model)
    again = {MODEL: model_to_json(model), DIAGNOSIS: diagnosis_to_json(diagnosis)}
    numbers = identical = 0
    differences: list[Difference] = []
    for name, made in again.items():
        for place, was, now in pairs(_document(archive, name, path), json.loads(dump_json(made))):
            if place.endswith(NO_RESULT):
                continue
            if _is_number(was) and _is_number(now):
                numbers += 1
                identical += was == now
                same = math.isclose(was, now, rel_tol=tolerance, abs_tol=0.0)
            else:
                same = was == now
            if not same:
                differences.append(Difference(f"{name}: {place}", was, now))
    return Replay(
        archive.signer,
        archive.trusted,
        numbers,
        identical,
        tolerance,
        tuple(differences),
        tuple(_packages(archive.parts.get(ENVIRONMENT, b"").decode("utf-8", "replace"))),
        tuple(str(m) for m in analysis.get("missing", [])),
    )


def pairs(was: Any, now: Any, place: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Every leaf of two documents with its place; ``None`` where one of them has none."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in (*was, *(k for k in now if k not in was)):
            yield from pairs(was.get(key), now.get(key), f"{place}.{key}" if place else str(key))
    elif isinstance(was, list) and isinstance(now, list):
        for k in range(max(len(was), len(now))):
            a, b = (side[k] if k < len(side) else None for side in (was, now))
            yield from pairs(a, b, f"{place}[{k}]")
    else:
        yield place, was, now


def _packages(bundled: str) -> list[str]:
    """Packages whose version here is another one, those that results depend on."""
    was, now = (
        dict(line.split("==", 1) for line in text.splitlines() if "==" in line)
        for text in (bundled, environment())
    )
    return [
        f"{name}: {was[name]} in the bundle, {now.get(name, 'none')} here"
        for name in ("invid", "numpy", "scipy", "numba", "llvmlite", "h5py")
        if name in was and was[name] != now.get(name)
    ]


def _analysis(archive: Archive, path: Path) -> dict[str, Any]:
    found = _document(archive, ANALYSIS, path)
    form = found.get("format"), found.get("format_version")
    if form != ("invid-bundle", 1):
        raise InputError(f"{path}: {ANALYSIS}: is of format {form[0]!r}, version {form[1]!r}")
    return found


def _document(archive: Archive, name: str, path: Path) -> dict[str, Any]:
    try:
        document = json.loads(archive.parts[name])
    except KeyError:
        raise InputError(f"{path}: {name}: is missing") from None
    except ValueError:
        raise InputError(f"{path}: {name}: is no JSON") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: {name}: is no JSON object")
    return document


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:59] + "…"
