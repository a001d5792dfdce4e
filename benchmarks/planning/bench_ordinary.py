"""Do ordinary healthy cells get a plan, run, and keep what was announced? Whole runs in virtual time.

    nice python benchmarks/planning/bench_ordinary.py [--cells 100] [--seed 1] [--named]

Cells are drawn as users describe theirs (``tests/machines/ordinary.py``), none tuned, measured by the default
plan; travel, velocity and torque are the plant's own. "watch": until a drive stops without its master.
"torque": what the ways to rest left of it before the run; "scale": what the run left of that. "expected" is
the worst relative standard deviation of masses, springs and couplings, of the plant itself, with all torque
that the config asks for and with what was left. ``--named`` runs the demo, the service's simulated
cell, the examples of ``configs/`` and what ``invid init`` writes for the first drawn cells instead.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from machines.named import named_cells
from machines.ordinary import Measured, measure, ordinary

from invid.config import CellConfig
from invid.numerics.arrays import frozen_float
from invid.planning import Plan, make_plan
from invid.planning.belief import Belief
from invid.planning.expected_covariance import expected
from invid.planning.forecast import lower_torque
from invid_drivers.foretelling import sensor_noise
from invid_drivers.simulated import simulation_of, truth

HEAD = (
    "  cell                 axes cycle  watch  speed torque scale   travel velocity torque  of limits   "
    "expected full  left"
)


def plant_belief(config: CellConfig) -> Belief:
    """The plant that stands behind a simulated cell."""
    chains, simulation = truth(config), simulation_of(config)
    zero = frozen_float(np.zeros(len(config.axes)))
    coulomb = [simulation.axis(a.name).friction.coulomb for a in config.axes]
    bare = replace(chains, ground_dampers=zero)
    return Belief(bare, chains.ground_dampers, frozen_float(coulomb), "the plant", False)


def worst(config: CellConfig, plan: Plan, share: float) -> float:
    """Worst relative standard deviation of the goal's parameters with a share of the plan's torque."""
    lowered = lower_torque(plan, np.full(len(plan.axes), share))
    return expected(config, lowered, plant_belief(config), sensor_noise(config)).worst[1]


def row(name: str, found: Measured, seconds: float) -> str:
    """One cell."""
    config, plan = found.config, found.plan
    head = f"  {name:<20s} {len(config.axes):4d} {config.bus.cycle_s * 1e3:3.0f} ms"
    if plan is None or found.limited is None:
        return f"{head}  {found.error}"
    full = make_plan(config)
    torque = float(np.min(plan.peak_torque / full.peak_torque))
    speed = min(a.limits.velocity for a in found.limited.axes)
    scale = found.result.amplitude_scale if found.result is not None else float("nan")
    ratios, limits = (found.peaks / found.announced).max(axis=1), (found.peaks / found.limits).max()
    watches = [b.case.facts.watch_s for b in found.budgets]
    watch = "none" if None in watches else f"{1e3 * max(w or 0.0 for w in watches):.0f} ms"
    before, after = worst(config, full, 1.0), worst(config, plan, scale) if found.result else np.nan
    return (
        f"{head} {watch:>6s} {speed:6.2f} {torque:6.0%} {scale:5.2f}   {ratios[0]:6.2f} {ratios[1]:8.2f} "
        f"{ratios[2]:6.2f} {limits:10.2f}   {before:12.3%} {after:7.3%}  {seconds:4.0f} s  {found.error}"
    )


def main() -> None:
    """Print a row a cell, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--named", action="store_true")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.cells)
    cells = named_cells() if options.named else ((f"seed {s}", ordinary(s)) for s in seeds)
    done, count, beyond = 0, 0, 0
    print(HEAD)
    for name, config in cells:
        began = time.process_time()
        found = measure(config)
        over = bool((found.peaks > found.limits * 1.001).any())
        if found.plan is not None:
            over = over or bool((found.peaks > found.announced * 1.001).any())
        count, done, beyond = count + 1, done + (found.result is not None), beyond + over
        print(row(name, found, time.process_time() - began), flush=True)
    print(f"\n{done} of {count} measured by the default plan; {beyond} beyond what was announced or a limit")


if __name__ == "__main__":
    main()
