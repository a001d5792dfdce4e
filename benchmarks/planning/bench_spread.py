"""Planning: what runs from rest do beyond the climb on which their amplitude is tried.

    python benchmarks/planning/bench_spread.py [--cells N] [--first S]

Healthy cells of ``tests/machines/cells.py`` with one to four axes and the default plan, in virtual time; the
truth is the plant's own. Says how often motion goes beyond ``SPREAD_CLIMB`` times that of the climb in
proportion to the torque, and beyond what was announced after the trials.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from invid.planning.phases import SPREAD_CLIMB

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from machines.cells import by_default, draw, run

MOST_AXES = 4


def main() -> int:
    """Run the cells and print one line of each, then how often what was passed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cells", type=int, default=76)
    parser.add_argument("--first", type=int, default=9300)
    options = parser.parse_args()
    ended = 0
    spreads: list[np.ndarray] = []
    beyond: list[np.ndarray] = []
    seed = options.first
    while len(spreads) < options.cells:
        drawn = draw(seed)
        seed += 1
        if len(drawn.config.axes) > MOST_AXES:
            continue
        truth = run(by_default(drawn))
        if truth.error is not None:
            ended += 1
            print(f"cell {seed - 1}: {truth.error}"[:150], flush=True)
            continue
        climb, *shares = truth.shares
        tried = truth.peaks["trying the amplitude"][:2] / climb
        runs = [truth.peaks[f"experiment {k + 1} of {len(shares)}"][:2] / s for k, s in enumerate(shares)]
        spreads.append((np.max(runs, axis=0) / tried).max(axis=1))
        after = [r for name, r in zip(truth.peaks, truth.ratios(), strict=True) if "experiment" in name]
        beyond.append(np.max(after, axis=(0, 2)))
        print(
            f"cell {seed - 1}, {len(drawn.config.axes)} axes: travel {spreads[-1][0]:.2f} and velocity "
            f"{spreads[-1][1]:.2f} of the climb's; of what was announced at most {beyond[-1].max():.2f}",
            flush=True,
        )
    (travel, velocity), over = np.transpose(spreads), np.max(beyond, axis=1)
    print(
        f"{len(spreads)} cells, beyond {SPREAD_CLIMB:g} of the climb's: travel in "
        f"{(travel > SPREAD_CLIMB).sum()} ({travel.max():.2f} at most), velocity in "
        f"{(velocity > SPREAD_CLIMB).sum()} ({velocity.max():.2f}); beyond what was announced in "
        f"{(over > 1).sum()}, by {max(over.max() - 1, 0.0):.0%} at most; {ended} more were ended at a limit"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
