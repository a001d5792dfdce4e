"""What the limits of the diagnosis decide: each is moved both ways on hidden cases where it is near.

    python benchmarks/diagnosis/bench_limits.py [--trials N] [--start SEED] [--jobs 2] [--kind pair]
                                                [--limit diagnosis.acceptance.REMAINDER] [--json ROWS.jsonl]

A limit that is a guess, or was read off other data, is worth what this prints: in how many cases it was
compared with something between it and its other value, and of how many that value changes the outcome, for
the better and for the worse. Only those cases are diagnosed again: elsewhere it decides the same.
"""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

LIMITS: dict[str, tuple[float, float]] = {
    "diagnosis.linear_fit.FAR": (2.0, 6.0),
    "diagnosis.linear_fit.LOWER": (0.25, 0.8),
    "diagnosis.search_pass.SAME_MACHINE": (2.5, 10.0),
    "diagnosis.acceptance.REMAINDER": (0.12, 0.5),
    "diagnosis.acceptance.NAMED_SHARE": (0.8, 0.95),
    "diagnosis.acceptance.SHARE": (0.025, 0.1),
    "diagnosis.acceptance.REACHED": (1.5, 3.0),
    "diagnosis.evidence.CLOSE": (1.25, 2.0),
    "diagnosis.evidence.HELD_OUT": (3.8, 10.8),
    "diagnosis.evidence.LARGER": (6.0, 13.8),
    "diagnosis.evidence.WEAK": (1e-5, 1e-7),
    "diagnosis.candidates.REACH": (2.0, 6.0),
    "diagnosis.candidates.UNEXPLAINED": (1.2, 3.0),
    "diagnosis.confidence.NAMED": (0.8, 0.95),
    "diagnosis.confidence.MOST_OF_CHI2": (0.3, 0.7),
    "diagnosis.confidence.COMPETES": (4.0, 16.0),
    "diagnosis.confidence.AT_FLOOR": (1.2, 2.0),
    "diagnosis.confidence.STRIBECK_EXCLUDED": (200.0, 800.0),
    "diagnosis.confidence.LEAST_STATIC": (0.2, 0.8),
    "diagnosis.trust.REACHED": (1.5, 3.0),
    "diagnosis.trust.LEFT": (0.01, 0.04),
    "diagnosis.trust.LEAST_EXPLAINED": (0.8, 0.95),
    "diagnosis.rules.tones.SHARE": (0.6, 0.9),
    "likelihood.nuisance.hold_share.HOLD_BAND": (2.0, 8.0),
    "diagnosis.time_domain_check.AGREEMENT": (1.5, 3.0),
}
"""Each limit with the two values tried instead. HELD_OUT: 5 % and 0.1 % of noise; LARGER: 5 % and 0.1 %."""
ALWAYS = ("diagnosis.evidence.WEAK",)
"""Limits that are not compared themselves but give a quantile: tried on all cases without a clear excess."""
CLEAR = 3.0
"""Size over the noise [dB] from which those are not tried."""


class Watched(float):
    """A limit that notes what it is compared with, over itself; products with plain numbers watch on."""

    __array_ufunc__ = None  # numpy's scalars leave the arithmetic to this class
    seen: list[float]
    factor: float

    def __new__(cls, value: float, seen: list[float], factor: float = 1.0) -> Watched:
        self = super().__new__(cls, value)
        self.seen, self.factor = seen, factor
        return self

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray) and other.ndim:
            return float(self) * other
        return Watched(float(self) * float(other), self.seen, self.factor * float(other))

    __rmul__ = __mul__

    def _noted(self, other: Any) -> float:
        if self.factor != 0.0:
            self.seen.append(float(other) / self.factor)
        return float(other)

    def __lt__(self, other: Any) -> bool:
        return float(self) < self._noted(other)

    def __le__(self, other: Any) -> bool:
        return float(self) <= self._noted(other)

    def __gt__(self, other: Any) -> bool:
        return float(self) > self._noted(other)

    def __ge__(self, other: Any) -> bool:
        return float(self) >= self._noted(other)

    __hash__ = float.__hash__


@contextmanager
def limits(values: dict[str, float]) -> Iterator[None]:
    """These limits in force, in their module and wherever it is imported."""
    before: list[tuple[Any, str, float]] = []
    for name, value in values.items():
        home, constant = name.rsplit(".", 1)
        old = getattr(importlib.import_module(f"invid.{home}"), constant)
        for key, module in list(sys.modules.items()):
            if key.startswith("invid.") and module.__dict__.get(constant) is old:
                before.append((module, constant, old))
                setattr(module, constant, value)
    try:
        yield
    finally:
        for module, constant, old in before:
            setattr(module, constant, old)


def current(name: str) -> float:
    """The value that the product has."""
    home, constant = name.rsplit(".", 1)
    return float(getattr(importlib.import_module(f"invid.{home}"), constant))


def trial(job: tuple[int, str | None, tuple[str, ...]]) -> dict[str, Any]:
    """One hidden case, with every limit as it is and then moved where that can matter."""
    from hidden.generator import make_case
    from hidden.scoring import score

    from invid.diagnosis.diagnose import diagnose
    from invid.errors import InvidError

    seed, kind, names = job
    recording, truth = make_case(seed, kind=kind)

    def said() -> tuple[str, str]:
        try:
            diagnosis = diagnose(recording)
        except InvidError as error:
            return "refused", str(error)
        result = score(truth, diagnosis)
        return result.outcome + ("!" if result.wrong_confident else ""), result.named

    seen: dict[str, list[float]] = {name: [] for name in names}
    watched = [name for name in names if name not in ALWAYS]
    with limits({name: Watched(current(name), seen[name]) for name in watched}):
        outcome = said()
    row: dict[str, Any] = {"seed": seed, "kind": truth.kind, "db": truth.db, "said": outcome, "moved": {}}
    for name in names:
        for value in LIMITS[name]:
            low, high = sorted((value, current(name)))
            weak = truth.kind == "null" or truth.db < CLEAR
            if any(low <= x <= high for x in seen[name]) or (name in ALWAYS and weak):
                with limits({name: value}):
                    row["moved"][f"{name}={value:g}"] = said()
    return row


def report(rows: list[dict[str, Any]], names: tuple[str, ...]) -> None:
    """One line a limit and value on stdout."""
    right = sum(r["said"][0] == "right" for r in rows)
    print(f"\n{right} of {len(rows)} right as the limits are.")
    print(f"{'limit':<26} {'value':>7} {'tried':>7} {'near':>5} {'better':>7} {'worse':>6}  seeds")
    for name in names:
        for value in LIMITS[name]:
            near = [(r, r["moved"][k]) for r in rows if (k := f"{name}={value:g}") in r["moved"]]
            changed: dict[str, list[str]] = defaultdict(list)
            for r, moved in near:
                if moved[0] != r["said"][0]:
                    better = moved[0] == "right" or r["said"][0].endswith("!")
                    changed["better" if better else "worse"].append(f"{r['seed']} {r['said'][0]}→{moved[0]}")
            print(
                f"{name:<26} {current(name):7g} {value:7g} {len(near):5d} {len(changed['better']):7d} "
                f"{len(changed['worse']):6d}  {'; '.join([*changed['better'], *changed['worse']])}"
            )


def main() -> int:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=70)
    parser.add_argument("--start", type=int, default=920000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kind", choices=("catalogue", "pair", "null", "outside", "wrong_order"))
    parser.add_argument("--limit", action="append", choices=sorted(LIMITS))
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    names = tuple(args.limit or LIMITS)
    jobs = [(args.start + i, args.kind, names) for i in range(args.trials)]
    rows = []
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        for row in pool.imap_unordered(trial, jobs):
            rows.append(row)
            words = f"seed {row['seed']} {row['said'][0]}, {len(row['moved'])} moved"
            print(words, file=sys.stderr, flush=True)
            if args.json:
                with args.json.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    report(sorted(rows, key=lambda r: r["seed"]), names)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
