"""Memory that long records take: half an hour of six axes at 1 kHz, identified and diagnosed in a child each.

    python benchmarks/diagnosis/bench_memory.py [--minutes 30] [--experiments 12] [--budget 60]
                                                [--keep REC.h5]

The recording is of a plant that shares no code with the product, with dry friction on two axes, and is
written experiment by experiment with all columns that `invid measure` logs. Printed are peak resident memory,
time and exit status of each command; exit status 1 where one took more than 1 GB.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from benchmarks.shared import plant_oracle as oracle

AXES, RATE, PERIOD = 6, 1000.0, 10_000
BAR_MB = 1000.0
RESOLUTION = 2 * np.pi / 2**19


def plant() -> oracle.OraclePlant:
    """Six axes of two masses, their ends coupled to the next one's."""
    rng = np.random.default_rng(11)
    masses = [[float(m), float(0.6 * m)] for m in rng.uniform(0.5, 2.0, AXES)]
    springs = [
        [float((2 * np.pi * f) ** 2 * m[0] * m[1] / sum(m))]
        for f, m in zip(np.linspace(7.0, 14.0, AXES), masses, strict=True)
    ]
    dampers = [[float(0.02 * k[0] / (2 * np.pi * 10.0))] for k in springs]
    couplings = {(i, i + 1): 0.05 * masses[i][1] for i in range(AXES - 1)}
    friction = tuple(0.3 if i in (1, 4) else 0.0 for i in range(AXES))
    return oracle.OraclePlant(masses, springs, dampers, couplings, coulomb=friction, viscous=(0.2,) * AXES)


def write(path: Path, minutes: float, experiments: int) -> int:
    """Writes ``experiments`` multisines on all axes at once, one by one; how many samples each axis has."""
    rng = np.random.default_rng(12)
    cell = plant()
    sums = np.array([sum(m) for m in cell.masses])
    gain, peak = 20.0 * sums, 10.0 * sums
    periods = max(2, round(minutes * 60.0 * RATE / PERIOD / experiments))
    total = 0
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {
                "format": "invid-recording", "format_version": 1, "created": "2026-11-24T00:00:00Z",
                "robot": "long", "axes": json.dumps([f"A{i + 1}" for i in range(AXES)]),
                "masses_per_axis": np.full(AXES, 2), "position_unit": "rad", "torque_unit": "N·m",
                "encoder_resolution": np.full(AXES, RESOLUTION),
            }
        )  # fmt: skip
        for number in range(experiments):
            drawn = [oracle.multisine(rng, PERIOD, RATE, (0.5, 20.0), odd=False) for _ in range(AXES)]
            waves, lines = zip(*drawn, strict=True)
            demand = np.tile(peak * np.stack(waves, axis=1), (periods + 1, 1))
            position, torque = oracle.simulate(
                cell, demand, RATE, gain=gain, damping=np.sqrt(gain * sums), in_drive=False
            )
            keep = slice(PERIOD, None)
            position = np.round(position[keep] / RESOLUTION) * RESOLUTION
            torque = torque[keep] + 0.005 * peak * rng.standard_normal(torque[keep].shape)
            node = file.create_group(f"experiments/{number:03d}")
            node.attrs.update(
                {
                    "kind": "multisine", "excited_axis": -1, "hold_gain": gain, "period_samples": PERIOD,
                    "role": "validate" if experiments > 2 and number == experiments - 1 else "identify",
                    "frequencies_hz": np.unique(np.concatenate(lines)), "sample_rate_hz": RATE,
                }
            )  # fmt: skip
            node["time"] = np.arange(position.shape[0]) / RATE
            node["position"], node["torque"], node["torque_demand"] = position, torque, demand[keep]
            node["status"] = np.full(position.shape, 0x1237, dtype=np.uint16)
            total += position.shape[0]
    return total


def measured(arguments: list[str]) -> tuple[float, float, int]:
    """Peak resident memory [MB] of the largest process of a command, its time [s], its exit status."""
    began = time.monotonic()
    child = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    return used.ru_maxrss / 1024.0, time.monotonic() - began, os.waitstatus_to_exitcode(status)


def main() -> int:
    """Write, run, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--experiments", type=int, default=12)
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    invid = [sys.executable, "-m", "invid"]
    passed = True
    with tempfile.TemporaryDirectory() as folder:
        recording = asked.keep or Path(folder) / "long.h5"
        samples = write(recording, asked.minutes, asked.experiments)
        size = recording.stat().st_size / 1e6
        print(
            f"{samples / RATE / 60:.0f} min of {AXES} axes at {RATE:.0f} Hz, {asked.experiments} records: "
            f"{size:.0f} MB of numbers; this process took "
            f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB to write them"
        )
        model = Path(folder) / "model.json"
        budget = ["--budget", f"{asked.budget:g}"]
        for name, more in (
            ("identify", ["-o", str(model)]),
            ("diagnose", ["--model", str(model), "-o", str(Path(folder) / "diagnosis.json")]),
        ):
            peak, took, status = measured([*invid, name, str(recording), *more, *budget])
            ended = "" if status in (0, 3) else f", exit status {status}: FAILED"
            print(f"invid {name:9s} peak {peak:6.0f} MB (bar {BAR_MB:.0f}), {took:5.0f} s{ended}", flush=True)
            passed &= peak < BAR_MB and not ended
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
