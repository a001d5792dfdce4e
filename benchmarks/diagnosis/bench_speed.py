"""Processor seconds of identification and diagnosis on one core, and their ratio to a fixed workload.

    python benchmarks/diagnosis/bench_speed.py [CASE …] [--timeout 1800]

Every command runs in a process of its own, bound to one core; counted is what it used after its imports. The
reference workload (FFTs, sorts and small solves) runs in the same process before it, so that the ratio says
the same on a faster machine.

plain, dry        three axes, 20 s an experiment: nothing hidden; dry friction on each
demo              the demo's recording: three axes, dry and viscous friction on each
rubbing, cell     three axes, 200 s, dry and viscous friction on each; a ripple and a gap besides
aperiodic         one axis, 2 × 10 s at 2 kHz, chirps that do not repeat, friction at the motor, N unknown
bench             a motor bench (../shared/data/flexible_drive), 20 periods of 2,500 samples, N unknown
six, eight        identification of M = 6 and M = 8 axes of three masses, all shaken at once
help              `invid --help`, imports and all
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from hidden.generator import make_cell

from benchmarks.diagnosis.bench_real_data import DATA, ROOT
from benchmarks.frozen.cases import command
from benchmarks.identification.bench_identify import measured
from benchmarks.shared import plant_oracle as oracle
from invid.config import load_config
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.model.diagnosis_document import load_model
from invid.recording import read_recording, write_recording
from invid.recording.model import Experiment, Kind, Recording, Role
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated import CASE_STUDY

BARS = {
    ("demo", "identify"): 1.0, ("demo", "diagnose"): 5.0, ("cell", "identify"): 1.5,
    ("cell", "diagnose"): 15.0, ("aperiodic", "diagnose"): 15.0, ("bench", "diagnose"): 5.0,
    ("six", "identify"): 30.0,
    ("eight", "identify"): 60.0, ("help", "help"): 0.3,
}  # fmt: skip
"""CPU seconds; a diagnosis of ``aperiodic`` and ``bench`` identifies first, others start from the model."""


def demo(place: Path) -> None:
    """The demo's measurement."""
    measure_to_file(load_config(CASE_STUDY), place)


FRICTION = (("coulomb_friction", 25.0), ("viscous_friction", 20.0))
"""Laws at every motor, and how far they stand above the noise [dB]."""
FAULTS = (("cogging", 0, 1, 20.0), ("backlash", 2, 1, 25.0))
"""Further causes, their axes and elements, and the same."""


def cell(place: Path, *, laws: int = 2, faults: tuple[Any, ...] = (), periods: int = 4) -> None:
    """Three axes of the paper's chains with friction on each, and faults besides."""
    rubbing = [(name, axis, 1, db) for axis in range(3) for name, db in FRICTION[:laws]]
    recording, _ = make_cell(
        [*rubbing, *faults],
        seed=25,
        moves=False,
        periods=periods,
        from_rest=False,
        drive="sampled",
        noise=2e-3,
    )
    write_recording(recording, place)


def aperiodic(place: Path) -> None:
    """Two chirps of 10 s at 2 kHz of one axis of two masses, dry and viscous friction at the motor."""
    rng, rate, seconds = np.random.default_rng(2), 2000.0, 10.0
    masses, springs = [[0.05, 0.12]], [[90.0]]
    plant = oracle.OraclePlant(masses, springs, [[0.03]], coulomb=(0.25,), viscous=(0.05,))
    t = np.arange(int(rate * seconds)) / rate
    experiments = []
    for number, (low, high, peak) in enumerate(((0.5, 15.0, 3.0), (1.0, 12.0, 2.2))):
        sweep = np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * seconds)))
        demand = peak * sweep[:, None] * np.minimum(1.0, t / 0.2)[:, None]
        position, torque = oracle.simulate(plant, demand, rate, gain=np.array([1.5]), damping=np.array([0.2]))
        step = 2 * np.pi / 2**20
        experiments.append(
            Experiment(
                f"{number:03d}", Kind.CHIRP, Role.IDENTIFY, 0, np.full(1, np.nan), 0, np.zeros(0), rate,
                number * (seconds + 1) + t, np.round(position / step) * step,
                torque + 0.01 * rng.standard_normal(torque.shape),
            )
        )  # fmt: skip
    recording = Recording("arm", ("J1",), "rad", "N·m", "2026-11-24T00:00:00Z", tuple(experiments))
    write_recording(recording, place)


def bench(place: Path) -> None:
    """The motor bench as it was measured, but for the number of masses."""
    chart = yaml.safe_load((ROOT / "configs" / "import" / "flexible_drive.yaml").read_text(encoding="utf-8"))
    del chart["axes"][0]["masses"]
    unknown = place.with_suffix(".yaml")
    unknown.write_text(yaml.safe_dump(chart), encoding="utf-8")
    source = DATA / "flexible_drive" / "MultisineTypeB.mat"
    command("import", str(source), "--map", str(unknown), "-o", str(place))


def large(count: int) -> Callable[[Path], None]:
    """``count`` axes of three masses, every one shaken; 20 s an experiment."""

    def make(place: Path) -> None:
        rng = np.random.default_rng(0)
        plant = oracle.random_plant(rng, [3] * count)
        mass, _, stiffness, _ = plant.matrices
        top = float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())) / 2 / np.pi
        peak = 10.0 * np.array([sum(m) for m in plant.masses])
        recording = measured(plant, rng, peak, periods=2, top_hz=1.25 * top)
        write_recording(replace(recording, masses_per_axis=(3,) * count), place)

    return make


BOTH = ("identify", "diagnose")
CASES: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "plain": (partial(cell, laws=0, periods=2), BOTH), "dry": (partial(cell, laws=1, periods=2), BOTH),
    "demo": (demo, BOTH), "rubbing": (cell, BOTH), "cell": (partial(cell, faults=FAULTS), BOTH),
    "aperiodic": (aperiodic, ("diagnose",)), "bench": (bench, ("diagnose",)),
    "six": (large(6), ("identify",)), "eight": (large(8), ("identify",)),
    "help": (lambda _: None, ("help",)),
}  # fmt: skip


def reference() -> float:
    """CPU seconds of the reference workload."""
    rng = np.random.default_rng(0)
    wave, numbers = rng.standard_normal((40_000, 4)), rng.standard_normal(1_000_000)
    matrices = rng.standard_normal((20_000, 6, 6)) + 6.0 * np.eye(6)
    sides = rng.standard_normal((20_000, 6, 1))
    started = time.process_time()
    for _ in range(20):
        np.fft.irfft(np.fft.rfft(wave, axis=0), axis=0)
        np.sort(numbers)
        np.linalg.solve(matrices, sides)
    return time.process_time() - started


def timed(task: str, recording: Path, model: Path) -> dict[str, Any]:
    """Runs one task in this process, bound to one core; what it used and what it answered."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    yardstick, who, answer = reference(), resource.RUSAGE_SELF, ""
    if task == "help":
        subprocess.run([sys.executable, "-m", "invid", "--help"], check=True, stdout=subprocess.DEVNULL)
        who, started = resource.RUSAGE_CHILDREN, 0.0
    else:
        data, given = read_recording(recording), load_model(model) if model.exists() else None
        started = sum(resource.getrusage(who)[:2])
        if task == "identify":
            found = identify(data)
            found.save(model)
            answer = " ".join(str(n) for n in found.chains.masses_per_branch)
        else:
            made = diagnose(data, model=given)
            answer = " ".join([str(made.verdict), *(f"{f.cause}@{f.axis}" for f in made.findings)])
    used = resource.getrusage(who)
    seconds = used.ru_utime + used.ru_stime - started
    return {
        "cpu_s": seconds,
        "ratio": seconds / yardstick,
        "peak_MB": used.ru_maxrss / 1024,
        "answer": answer,
    }


def run(case: str, task: str, cache: Path, seconds: float) -> bool:
    """One line of the table, of a task in a process of its own; whether its bar is held."""
    recording, model = cache / f"{case}.h5", cache / f"{case}.model.json"
    command = [sys.executable, __file__, "--task", task, str(recording), str(model)]
    own = {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(str(ROOT / p) for p in (".", "drivers", "service")),
    }
    try:
        done = subprocess.run(
            command, env=os.environ | own, capture_output=True, text=True, timeout=seconds, check=True
        )
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
        print(f"{case:<10} {task:<9} {error}", flush=True)
        return False
    now = json.loads(done.stdout.splitlines()[-1])
    bar = BARS.get((case, task), np.inf)
    held = bool(now["cpu_s"] <= bar)
    against = f" (bar {bar:g}){'' if held else ' MISSED'}" if np.isfinite(bar) else ""
    print(
        f"{case:<10} {task:<9} {now['cpu_s']:8.2f} s{against}, {now['ratio']:.2f} × reference, "
        f"{now['peak_MB']:.0f} MB: {now['answer']}",
        flush=True,
    )
    return held


def main() -> int:
    """See the module's docstring; exit status 1 where a bar is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all without")
    parser.add_argument("--task", help=argparse.SUPPRESS)
    parser.add_argument("--timeout", type=float, default=1800.0, help="wall seconds that one task may take")
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    parser.add_argument("--cache", type=Path, default=home / "invid-speed")
    options = parser.parse_args()
    if options.task:
        print(json.dumps(timed(options.task, *map(Path, options.cases))))
        return 0
    options.cache.mkdir(parents=True, exist_ok=True)
    held = True
    for case in options.cases or CASES:
        make, tasks = CASES[case]
        (options.cache / f"{case}.model.json").unlink(missing_ok=True)
        if case != "help" and not (options.cache / f"{case}.h5").exists():
            print(f"{case}: making the recording", file=sys.stderr, flush=True)
            make(options.cache / f"{case}.h5")
        for task in tasks:
            held &= run(case, task, options.cache, options.timeout)
    return int(not held)


if __name__ == "__main__":
    sys.exit(main())
