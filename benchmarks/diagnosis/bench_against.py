"""Wrong simulators of cells that MuJoCo simulated: judged, corrected, and the copy run on a record kept out.

    python benchmarks/diagnosis/bench_against.py 1:13 [--budget 60]

A cell of one or two axes with one to three hidden elements is recorded; its XML without them and every
number 5 to 50 % off is judged and corrected, the XML that made the recording is judged as well. A row a case.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import numpy as np
from machines.mujoco_cells import SIZES, Cell, drawn, measured, users, write

import invid
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator

REACHED = 1.3
"""Floors within which a corrected copy is called mended."""


def case(seed: int) -> Cell:
    """One or two axes of one or two masses, with one to three hidden elements."""
    rng = np.random.default_rng([seed, 391])
    sizes = tuple(int(n) for n in rng.integers(1, 3, rng.integers(1, 3)))
    cell = drawn(seed, kinds=tuple(str(k) for k in rng.permutation(list(SIZES))), sizes=sizes)
    return replace(cell, hidden=cell.hidden[: int(rng.integers(1, 4))])


def off(rng: np.random.Generator, rows: Any) -> tuple[Any, ...]:
    """Every number 5 to 50 % too large, or too small by the same factor."""
    return tuple(
        tuple(float(x * (1.0 + rng.uniform(0.05, 0.5)) ** rng.choice([-1, 1])) for x in r) for r in rows
    )


def one(seed: int, budget: float, folder: Path) -> tuple[bool, float, float]:
    """Whether the true simulator was called right; floors of the diagnosis and of the wrong one's copy."""
    cell, rng = case(seed), np.random.default_rng([seed, 392])
    record = folder / f"{seed}.h5"
    write(cell, measured(cell), record)
    recording = invid.read_recording(record)
    diagnosis = invid.diagnose(recording, budget=budget)
    numbers = {n: off(rng, getattr(cell, n)) for n in ("inertia", "springs", "dampers")}
    found = []
    for name, its in (("true", cell), ("wrong", replace(cell, hidden=(), **numbers))):
        text, copy = folder / f"{name}{seed}.xml", folder / f"mended{seed}.xml"
        text.write_text(users(its))
        simulator = open_simulator(text, recording.axes)
        found.append(judge(recording, diagnosis, simulator, copy if name == "wrong" else None))
    true, wrong = found
    before, after = wrong["held_out"]["before"], wrong["held_out"]["after"]
    own = max(r.after / r.noise_floor for r in diagnosis.residual)
    hidden = ", ".join(f"{h.kind} {cell.axes[h.axis]} {h.element} size {h.size:.3g}" for h in cell.hidden)
    named = ", ".join(f"{f.cause} {f.axis} {f.element} {f.confidence:.2f}" for f in diagnosis.findings)
    print(
        f"| {seed} | {hidden} | {named or 'nothing'} | {own:.2f}, {true['held_out']['before']:.2f}, "
        f"{before:.3g}, {'none' if after is None else f'{after:.2f}'} | {'; '.join(wrong['cannot_hold'])} |",
        flush=True,
    )
    return bool(true["right"]), own, before if after is None else after


def main() -> None:
    """Run the cases and print their table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="1:13", help="first:last+1")
    parser.add_argument("--budget", type=float, default=60.0)
    given = parser.parse_args()
    print("| seed | hidden | found | floors: diagnosis, true, wrong, copy | cannot hold |\n|" + " --- |" * 5)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(*map(int, given.seeds.split(":"))):
            try:
                rows.append(one(seed, given.budget, Path(folder)))
            except invid.InvidError as error:
                print(f"| {seed} | {error} | | | |", flush=True)
    print(f"true called right: {sum(right for right, _, _ in rows)} of {len(rows)}")
    good = [own <= REACHED for _, own, _ in rows]
    copies = [copy <= REACHED for _, _, copy in rows]
    both = sum(a and b for a, b in zip(good, copies, strict=True))
    print(f"copy within {REACHED} floors: {sum(copies)}; where the diagnosis is: {both} of {sum(good)}")


if __name__ == "__main__":
    main()
