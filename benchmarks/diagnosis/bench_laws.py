"""Laws that the catalogue does not have, hidden at random: which quantity and place the diagnosis finds.

python benchmarks/diagnosis/bench_laws.py 0:40 [--draw one|two|catalogue] [--decibels 25] [--budget 60]

Of four of the hidden laws one quantity of one place is all; of three, drawn by ``two``, two quantities of one
place. The others follow another axis, time or an event, and no such law is right for them. Of ``catalogue``
(causes of the catalogue, alone and in pairs, and nothing at all) none may become a law.
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
from hidden.generator import TrueEffect, Truth, make, make_case
from hidden.scoring import at_place

import invid

OVER = {
    "power_drag": "velocity",
    "end_stop": "position",
    "square_spring": "deflection",
    "saturating_spring": "deflection",
}
OVER_TWO = {
    "position_damping": "velocity and position",
    "worn_place": "velocity and position",
    "deflection_damping": "deflection and deflection rate",
}
PAIRS = ("saturating_spring", "cross_drag", "gyroscopic")
REACHED = 1.3
"""Floors that may be left beside the right law."""


def drawn(seed: int, kind: str, decibels: float) -> tuple[invid.Recording, Truth]:
    """One case of this kind."""
    rng = np.random.default_rng(seed)
    if kind == "catalogue":
        return make_case(seed, kind=str(rng.choice(["catalogue", "null", "pair"], p=[0.7, 0.2, 0.1])))
    if kind == "two":
        name = str(rng.choice(sorted(OVER_TWO)))
    else:
        others = sorted(set(OUTSIDE) - set(OVER))
        name = str(rng.choice(sorted(OVER) if rng.uniform() < 0.7 else others))
    motors = 2 if name in PAIRS else int(rng.integers(1, 3))
    return make(name, seed=seed, target_db=decibels, motors=motors)


def outcome(hidden: TrueEffect | None, found: invid.Diagnosis) -> str:
    """ "right", "wrong law", "named" (a cause of the catalogue, surely), "consistent" or "no law"."""
    laws = [f for f in found.findings if f.effect.table is not None]
    if hidden is None or hidden.in_catalogue:
        return "turned into a law" if laws else "no law"
    if any(f.confidence >= 0.9 for f in found.findings):
        return "named"
    if not laws:
        return "consistent" if found.verdict == "consistent" else "no law"
    right = [
        f
        for f in laws
        if f.effect.table is not None
        and " and ".join(f.effect.table.quantities) == (OVER | OVER_TWO).get(hidden.cause)
        and at_place(hidden, f.axis, f.element, f.other_axis)
    ]
    return "right" if right else "wrong law"


def main() -> None:
    """Runs and tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="0:40", help="first:last+1")
    parser.add_argument("--draw", choices=("one", "two", "catalogue"), default="one")
    parser.add_argument("--decibels", type=float, default=25.0)
    parser.add_argument("--budget", type=float, default=60.0)
    args = parser.parse_args()
    first, last = (int(n) for n in args.seeds.split(":"))
    table: Counter[tuple[str, str]] = Counter()
    reached = Counter[str]()
    for seed in range(first, last):
        recording, truth = drawn(seed, args.draw, args.decibels)
        name = " and ".join(e.cause for e in truth.effects) or "nothing"
        begun = sum(os.times()[:4])
        try:
            found = invid.diagnose(recording, budget=args.budget)
        except invid.InvidError as error:
            print(seed, name, error)
            continue
        said = outcome(truth.effects[0] if truth.effects else None, found)
        floors = max(r.after / r.noise_floor for r in found.residual)
        table[name, said] += 1
        reached[name] += said == "right" and floors <= REACHED
        cpu = sum(os.times()[:4]) - begun
        print(f"{seed} {name}: {said}, {found.verdict}, {floors:.2f} floors, {cpu:.0f} CPU s", flush=True)
    for name in sorted({n for n, _ in table}):
        counts = ", ".join(f"{said} {k}" for (n, said), k in sorted(table.items()) if n == name)
        over = (OVER | OVER_TWO).get(name)
        at = f" (over {over}); at {REACHED} floors {reached[name]}" if over else ""
        print(f"{name}: {counts}{at}")


if __name__ == "__main__":
    main()
