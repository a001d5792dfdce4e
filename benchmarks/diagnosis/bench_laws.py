"""Laws that the catalogue does not have, hidden at random: which quantity and place the diagnosis finds.

python benchmarks/diagnosis/bench_laws.py 0:40 [--decibels 25] [--budget 60]

Of four of the hidden laws one quantity of one place is all; the others follow two quantities, time or an
event, and no law of one quantity is right for them.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

import numpy as np
from hidden.causes import OUTSIDE
from hidden.generator import TrueEffect, make
from hidden.scoring import at_place

import invid

OVER = {
    "power_drag": "velocity",
    "end_stop": "position",
    "square_spring": "deflection",
    "saturating_spring": "deflection",
}
PAIRS = ("saturating_spring", "cross_drag", "gyroscopic")
REACHED = 1.3
"""Floors that may be left beside the right law."""


def outcome(hidden: TrueEffect, found: invid.Diagnosis) -> str:
    """ "right", "wrong law", "named" (a cause of the catalogue, surely), "consistent" or "no law"."""
    laws = [f for f in found.findings if f.effect.table is not None]
    if any(f.confidence >= 0.9 for f in found.findings):
        return "named"
    if not laws:
        return "consistent" if found.verdict == "consistent" else "no law"
    right = [
        f
        for f in laws
        if f.effect.table is not None
        and f.effect.table.over == OVER.get(hidden.cause)
        and at_place(hidden, f.axis, f.element, f.other_axis)
    ]
    return "right" if right else "wrong law"


def main() -> None:
    """Runs and tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="0:40", help="first:last+1")
    parser.add_argument("--decibels", type=float, default=25.0)
    parser.add_argument("--budget", type=float, default=60.0)
    args = parser.parse_args()
    first, last = (int(n) for n in args.seeds.split(":"))
    table: Counter[tuple[str, str]] = Counter()
    reached = Counter[str]()
    for seed in range(first, last):
        rng = np.random.default_rng(seed)
        name = str(rng.choice(sorted(OVER) if rng.uniform() < 0.7 else sorted(set(OUTSIDE) - set(OVER))))
        motors = 2 if name in PAIRS else int(rng.integers(1, 3))
        recording, truth = make(name, seed=seed, target_db=args.decibels, motors=motors)
        begun = sum(os.times()[:4])
        try:
            found = invid.diagnose(recording, budget=args.budget)
        except invid.InvidError as error:
            print(seed, name, error)
            continue
        said = outcome(truth.effects[0], found)
        floors = max(r.after / r.noise_floor for r in found.residual)
        table[name, said] += 1
        reached[name] += said == "right" and floors <= REACHED
        cpu = sum(os.times()[:4]) - begun
        print(f"{seed} {name}: {said}, {found.verdict}, {floors:.2f} floors, {cpu:.0f} CPU s", flush=True)
    for name in sorted({n for n, _ in table}):
        counts = ", ".join(f"{said} {k}" for (n, said), k in sorted(table.items()) if n == name)
        at = f"; at {REACHED} floors {reached[name]}" if name in OVER else ""
        print(f"{name} (over {OVER.get(name, 'no one quantity')}): {counts}{at}")


if __name__ == "__main__":
    main()
