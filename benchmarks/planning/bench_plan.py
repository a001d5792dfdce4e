"""Planning: robot time of every plan, to what it shows, beside settled periods.

    python benchmarks/planning/bench_plan.py [--seeds N] [--first S]

Everything runs through the simulated cell: drives on the virtual CAN bus, the sweep with its trials,
friction, encoder and torque quantisation, noise, hold controllers. Exit status 1 where a bar is missed: the
default plan (60 s, six of six frictions named) and --screen (12 s), none sure and wrong,
1 % on every mass, spring and coupling.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from invid.api import diagnose
from invid.config import CellConfig, load_config
from invid.errors import InvidError
from invid.identification.identify import identify
from invid.model.document import parameter_vector
from invid.planning.expected_covariance import is_in_goal, parameter_scale
from invid.recording import read_recording
from invid_drivers.cli.measure import screen_cell
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated import truth

CONFIG = Path(__file__).parents[2] / "configs" / "case-study.yaml"
GOAL = 0.01
FRICTIONS = ("coulomb_friction", "viscous_friction")
SURE = 0.9


def cell(seed: int, **changes: Any) -> CellConfig:
    """The case study with another seed of its noise."""
    document = load_config(CONFIG).model_dump(mode="python") | changes
    document["simulation"] = document["simulation"] | {"seed": seed}
    return CellConfig.model_validate(document)


def errors(config: CellConfig, path: Path) -> tuple[float, bool]:
    """Largest relative error of masses, springs and couplings, and whether the fit trusts itself."""
    plant = truth(config)
    names, values = parameter_vector(replace(plant, ground_dampers=np.zeros(plant.branches)))
    try:
        model = identify(read_recording(path), masses=(3, 3, 3))
    except InvidError as error:
        print(f"    {error}"[:150])
        return float("inf"), False
    _, found = parameter_vector(model.chains)
    off = np.abs(found - values) / parameter_scale(plant)
    return float(off[is_in_goal(names)].max()), bool(model.fit["trustworthy"])


@dataclass(frozen=True)
class Run:
    """One measurement: robot time, worst error, frictions named of six, and how many are sure and wrong."""

    seconds: float
    error: float
    named: int
    wrong: int


def judged(config: CellConfig, path: Path, seconds: float) -> Run:
    """What comes of a recording, against the truth."""
    worst, trusted = errors(config, path)
    true = {(cause, a.name) for cause in FRICTIONS for a in config.axes}
    found = {(f.cause, f.axis): f.confidence for f in diagnose(read_recording(path)).findings}
    wrong = sum(c >= SURE for key, c in found.items() if key not in true)
    return Run(seconds, worst if trusted else float("inf"), len(true & found.keys()), wrong)


def settled(config: CellConfig, path: Path) -> Run:
    """Three settled periods a run, with one to validate: what is waited for is thrown away."""
    period = {"kind": "multisine", "lines": "odd", "period_s": 8.192, "periods": 3, "settle_periods": 1}
    judge = period | {"role": "validate", "amplitude": 0.35, "experiments": 1, "seed": 2}
    changed = cell(config.simulation["seed"], experiments=[period | {"seed": 1}, judge])
    return judged(changed, path, measure_to_file(changed, path).duration_s)


def changed(config: CellConfig, path: Path) -> Run:
    """``--screen`` on the cell with a mass, spring or coupling of its own changed by 3 to 10 %, up or down,
    drawn by its seed; ``wrong`` where it is not called changed."""
    rng = np.random.default_rng(config.simulation["seed"])
    plant = truth(config)
    masses, springs = ([np.array(v) for v in vs] for vs in (plant.masses, plant.springs))
    couplings = np.array(plant.couplings)
    factor = float(1 + rng.choice([-1, 1]) * rng.uniform(0.03, 0.10))
    axis, place, kind = (int(rng.integers(3)) for _ in range(3))
    if kind == 0:
        masses[axis][place] *= factor
    elif kind == 1:
        springs[axis][place % 2] *= factor
    else:
        other = (axis + 1) % 3
        couplings[[axis, other], [other, axis]] *= factor
    branches = [
        {
            "axis": a.name,
            "masses_kgm2": masses[i].tolist(),
            "springs_Nm_per_rad": springs[i].tolist(),
            "dampers_Nms_per_rad": list(plant.dampers[i]),
        }
        for i, a in enumerate(config.axes)
    ]
    pairs = [
        {"between": [config.axes[i].name, config.axes[j].name], "value_kgm2": float(couplings[i, j])}
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    own = config.simulation | {"plant": {"branches": branches, "couplings": pairs}}
    now = CellConfig.model_validate(config.model_dump(mode="python") | {"simulation": own})
    return screened(config, now, path, "changed")


def screened(before: CellConfig, now: CellConfig, path: Path, right: str) -> Run:
    """``--screen`` of a cell against the model that the default plan gave of it before; ``wrong`` where it is
    not called ``right``."""
    measure_to_file(before, path)
    model = diagnose(read_recording(path)).model
    result, found = screen_cell(now, model, path)
    if found.verdict != right:
        print(f"    seed {now.simulation['seed']}: {found.sentence}"[:150])
    return Run(result.duration_s, float("nan"), 0, int(found.verdict != right))


PLANS = {
    # name: measurement, longest robot time [s], frictions to be named, share of the seeds
    "settled periods": (settled, np.inf, 0, 0.1),
    "default": (lambda c, p: judged(c, p, measure_to_file(c, p).duration_s), 60.0, 6, 1.0),
    "--screen": (lambda c, p: screened(c, c, p, "unchanged"), 12.0, 0, 1.0),
    "--screen changed": (changed, 12.0, 0, 1.0),
}


def robot_time(seeds: range, folder: Path) -> bool:
    """Robot time of plans side by side, and what comes of them."""
    passed = True
    print("time: robot seconds from enabling to the end, signs, trial and rests included")
    print("  plan             seeds  median s  longest s  worst error  named of 6  sure and wrong")
    for name, (measure, most, least, share) in PLANS.items():
        chosen = seeds[: max(1, round(share * len(seeds)))]
        runs = [measure(cell(seed), folder / "plan.h5") for seed in chosen]
        seconds = np.array([r.seconds for r in runs])
        worst, named, wrong = (
            max(r.error for r in runs),
            min(r.named for r in runs),
            sum(r.wrong for r in runs),
        )
        print(
            f"  {name:<16} {len(runs):5d}  {np.median(seconds):8.1f}  {seconds.max():9.1f}  {worst:11.2%}  "
            f"{named:10d}  {wrong:14d}",
            flush=True,
        )
        if np.isfinite(most):
            bars = np.median(seconds) <= most, not worst > GOAL, named >= least, wrong == 0
            passed &= all(bars)
    return bool(passed)


def main() -> int:
    """Run all plans."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wanted = range(options.first, options.first + options.seeds)
        return 0 if robot_time(wanted, Path(folder)) else 1


if __name__ == "__main__":
    sys.exit(main())
