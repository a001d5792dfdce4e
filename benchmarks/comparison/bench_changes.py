"""Grades and changes of causes: how often an unchanged cause is called grown, and a grown one found.

    nice python benchmarks/comparison/bench_changes.py [--pairs 200] [--runs 20] [--seed 1]

A small simulated cell with dry and viscous friction is measured, identified and diagnosed. Then

- drawn: pairs of models are drawn from that model, parameters by their joint covariance, every cause off by
  its own standard deviation (cheap: nothing is fitted, so it tests the comparison and not the estimates);
- measured: ``--runs`` whole runs, each with its own noise, and as many with the dry friction five standard
  deviations of the difference larger; all pairs of them, which are not independent.

The standard deviation of a difference of two runs is √2 times that of one.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from invid.comparison.causes import CHANGED
from invid.comparison.changes import CauseStatus, Comparison
from invid.comparison.compare import compare
from invid.config import parse_config
from invid.diagnosis.consequence import consequence_of, machine_of
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model
from invid.recording import Recording, read_recording
from invid_drivers.measurement import measure_to_file

DRY, VISCOUS = 0.5, 0.4
CELL = """\
format: invid-config
robot: small cell
bus: {interface: invid-virtual, channel: changes, cycle_s: 0.001}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    masses: 2
    inertia_kgm2: 3.0
    limits: {torque_Nm: 25, position_window_rad: 1.0, velocity_rad_per_s: 5}
experiments:
  - {kind: multisine, band_Hz: [0.5, 12], period_s: 2.048, periods: 3}
  - {kind: multisine, role: validate, band_Hz: [0.5, 12], period_s: 2.048, periods: 2, amplitude: 0.5}
simulation:
  plant:
    branches: [{axis: A1, masses_kgm2: [1.0, 2.0], springs_Nm_per_rad: [1500], dampers_Nms_per_rad: [1.0]}]
  defaults: {torque_noise_fraction_of_rated: 0.002}
"""
NAME = "A1.coulomb_friction.mass 1"


def run(seed: int, dry: float) -> tuple[Recording, Diagnosis]:
    """One whole run of the cell."""
    document: dict[str, Any] = yaml.safe_load(CELL)
    document["simulation"]["seed"] = seed
    document["simulation"]["axes"] = {"A1": {"friction": {"coulomb": dry, "viscous": VISCOUS}}}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.h5"
        measure_to_file(parse_config(yaml.safe_dump(document), source="bench_changes"), path)
        recording = read_recording(path)
    return recording, diagnose(recording, model=identify(recording))


def drawn(base: Model, rng: np.random.Generator, grown: float = 0.0) -> Model:
    """Another estimate of the same robot; ``grown`` is added to the dry friction [N·m]."""
    names, covariance = base.parameter_names, base.covariance
    if covariance is None:
        raise ValueError("the model has no joint covariance to draw from")
    drawn_by = rng.multivariate_normal(np.zeros(len(names)), covariance)
    off = dict(zip(names, drawn_by, strict=True))
    chains = base.chains
    for field, kind in (("masses", "mass"), ("springs", "spring"), ("dampers", "damper")):
        moved = tuple(
            v + np.array([off.get(f"{axis}.{kind}.{k + 1}", 0.0) for k in range(v.size)])
            for axis, v in zip(chains.axes, getattr(chains, field), strict=True)
        )
        chains = replace(chains, **{field: moved})
    effects = tuple(
        replace(
            t,
            parameters={
                n: replace(
                    e,
                    value=e.value
                    + (e.std or 0.0) * rng.standard_normal()
                    + (grown if t.cause == "coulomb_friction" else 0.0),
                )
                for n, e in t.parameters.items()
            },
        )
        for t in base.effects
    )
    return replace(base, chains=chains, effects=effects)


def dry_friction(model: Model) -> tuple[float, float]:
    """Size of the named dry friction and its standard deviation; NaN where it was not named."""
    for term in model.effects:
        if term.cause == "coulomb_friction":
            estimate = term.parameters["torque"]
            return estimate.value, estimate.std or math.nan
    return math.nan, math.nan


def tell(what: str, pairs: Sequence[Comparison], status: CauseStatus) -> None:
    """How many pairs call some cause grown, some cause changed, and the dry friction ``status``."""
    grew = sum(any(c.status is CauseStatus.GREW for c in p.causes) for p in pairs)
    changed = sum(any(c.status in CHANGED for c in p.causes) for p in pairs)
    dry = sum(any(c.name == NAME and c.status is status for c in p.causes) for p in pairs)
    count = len(pairs)
    print(
        f"  {what:58s} {count:4d} pairs: some cause grew {grew / count:6.1%}, "
        f"changed {changed / count:6.1%}, "
        f"dry friction {status} {dry / count:6.1%}",
        flush=True,
    )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    recording, diagnosis = run(options.seed, DRY)
    base = diagnosis.model
    size, std = dry_friction(base)
    named = ", ".join(f"{t.cause} {t.element}" for t in base.effects)
    print(f"{named}; dry friction {size:.4f} ± {std:.4f} N·m, true {DRY} N·m; drawn:")
    if not math.isfinite(std):
        sys.exit("the dry friction was not named: nothing to compare")
    five = 5.0 * math.sqrt(2.0) * std
    same = [compare(drawn(base, rng), drawn(base, rng)) for _ in range(options.pairs)]
    tell("nothing changed", same, CauseStatus.GREW)
    more = [compare(drawn(base, rng), drawn(base, rng, five)) for _ in range(options.pairs)]
    tell("dry friction grew by five deviations of the difference", more, CauseStatus.GREW)
    averaged = [
        compare(drawn(base, rng), drawn(base, rng, 5 * std), before=[drawn(base, rng) for _ in range(7)])
        for _ in range(options.pairs)
    ]
    tell("by five deviations of one run, against eight runs", averaged, CauseStatus.GREW)
    machine, _ = machine_of(diagnosis, recording)
    grades = [
        tuple(str(consequence_of(t, machine).grade) for t in drawn(base, rng).effects)
        for _ in range(2 * options.pairs)
    ]
    flips = sum(a != b for a, b in zip(grades[::2], grades[1::2], strict=True))
    print(f"  a grade differs in {flips} of {options.pairs} pairs; {', '.join(grades[0])}")
    if options.runs < 2:
        return
    print("measured:")
    usual = [run(options.seed + 1000 + k, DRY)[1].model for k in range(options.runs)]
    grown = [run(options.seed + 2000 + k, DRY + five)[1].model for k in range(options.runs)]
    values, stds = np.array([dry_friction(m) for m in usual]).T
    print(
        f"  dry friction named in {np.isfinite(values).sum()} of {options.runs}: "
        f"scatter {np.nanstd(values, ddof=1):.4f}, stated {np.nanmedian(stds):.4f} N·m"
    )
    pairs = [compare(a, b) for k, a in enumerate(usual) for b in usual[k + 1 :]]
    tell("nothing changed", pairs, CauseStatus.GREW)
    tell("grew by five deviations", [compare(a, b) for a in usual for b in grown], CauseStatus.GREW)


if __name__ == "__main__":
    main()
