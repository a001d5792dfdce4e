"""Does what is announced bound what happens? Random healthy cells through whole runs in virtual time.

    nice python benchmarks/planning/bench_announced.py [--cells 50] [--seed 1]

Travel, velocity and torque are the plant's own, in every phase: signs, trial, experiments with their starts,
run-ins and rests. A cell without a model is announced its limits before the trial, and what the trial
measured from then on. Times are those of the plan and of the run.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

QUANTITIES = ("travel", "velocity", "torque")


def main() -> None:
    """Print the table and the worst cells."""
    from machines.cells import draw, run

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rows, generous, times, stops, clipped = [], [], [], [], 0
    print(
        "  seed axes model amplitude scale   travel velocity torque   announced/measured   run/plan  clipped"
    )
    for seed in range(options.seed, options.seed + options.cells):
        started = time.monotonic()
        drawn = draw(seed)
        truth = run(drawn)
        worst = truth.ratios().max(axis=(0, 2))
        over = truth.generosity()
        ratio = truth.seconds / truth.plan.duration_s
        rows.append((worst, seed))
        clipped += truth.clipped > 0
        if truth.error is None:
            times.append(ratio)
            generous.append(over.reshape(3, -1))
        else:
            stops.append(f"{seed}: {truth.error}")
        spread = " ".join(f"{np.median(v):5.2f}" for v in over)
        print(
            f"  {seed:4d} {len(drawn.config.axes):4d} {'yes' if drawn.model else 'no':>5s} "
            f"{drawn.amplitude:9g} "
            f"{truth.scale:5.2f}   {worst[0]:6.2f} {worst[1]:8.2f} {worst[2]:6.2f}   {spread}    "
            f"{ratio:8.3f}  {truth.clipped:7d}  {time.monotonic() - started:4.1f} s  {truth.error or ''}",
            flush=True,
        )
    share = np.array([w for w, _ in rows])
    print(f"\n{len(rows)} cells; measured over announced, largest over phases and axes:")
    for k, what in enumerate(QUANTITIES):
        all_of = np.concatenate([g[k] for g in generous]) if generous else np.array([np.nan])
        print(
            f"  {what:9s} worst {share[:, k].max():.2f} (seed {rows[int(share[:, k].argmax())][1]}), beyond "
            f"1.0 in {(share[:, k] > 1).sum()} cells; announced over measured, median {np.median(all_of):.2f}"
        )
    off = np.abs(np.array(times) - 1)
    print(f"  run over plan time: worst {off.max(initial=0):.1%} off, beyond 5 % in {(off > 0.05).sum()}")
    print(f"  cells with clipped torque: {clipped}; that stopped themselves: {len(stops)}")
    for line in stops:
        print(f"    {line}")


if __name__ == "__main__":
    main()
