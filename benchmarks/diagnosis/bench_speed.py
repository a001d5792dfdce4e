"""Processor seconds of identification and diagnosis on one core, and their ratio to a fixed workload.

    python benchmarks/diagnosis/bench_speed.py [CASE …] [-o TABLE.json] [--against TABLE.json] [--timeout 600]

Every command runs in a process of its own, bound to one core; counted is what it used after its imports. The
reference workload (FFTs, sorts and small solves) runs in the same process before it, so that the ratio says
the same on a faster machine. ``--against`` prints the figures of an earlier table beside.

plain, dry        three axes, 20 s an experiment: nothing hidden; dry friction on each
demo              the demo's recording: three axes, dry and viscous friction on each
rubbing, cell     three axes, 200 s, dry and viscous friction on each; a ripple and a gap besides
aperiodic         one axis, 2 × 10 s at 2 kHz, chirps that do not repeat, friction at the motor, N unknown
bench             a motor bench (../shared/data/flexible_drive), 20 periods of 2,500 samples, N unknown
six, eight        identification of M = 6 and M = 8 axes of three masses, all shaken at once
growth            identification of one axis, 40 s, 80 s and 160 s
help              `invid --help`, imports and all
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

BARS = {
    ("demo", "identify"): 1.0, ("demo", "diagnose"): 5.0, ("cell", "identify"): 1.5,
    ("cell", "diagnose"): 15.0, ("aperiodic", "diagnose"): 15.0, ("bench", "diagnose"): 5.0,
    ("six", "identify"): 30.0,
    ("eight", "identify"): 60.0, ("help", "help"): 0.3,
}  # fmt: skip
"""CPU seconds; a diagnosis of ``aperiodic`` and ``bench`` identifies first, others start from the model."""
ALONE = ("aperiodic", "bench")
"""Cases whose diagnosis is given no model."""
IDENTIFIED = ("six", "eight", "growth40", "growth80", "growth160")
"""Cases that are identified only."""


def demo(place: Path) -> None:
    """The demo's measurement."""
    from invid.config import load_config
    from invid_drivers.measurement import measure_to_file
    from invid_drivers.simulated import CASE_STUDY

    measure_to_file(load_config(CASE_STUDY), place)


FRICTION = (("coulomb_friction", 25.0), ("viscous_friction", 20.0))
"""Laws at every motor, and how far they stand above the noise [dB]."""
FAULTS = (("cogging", 0, 20.0), ("backlash", 2, 25.0))
"""Further causes, their axes and the same."""


def cell(
    place: Path, *, friction: tuple[Any, ...] = FRICTION, faults: tuple[Any, ...] = FAULTS, periods: int = 4
) -> None:
    """Three axes of the paper's chains with friction on each, and faults besides."""
    from hidden.causes import CATALOGUE
    from hidden.generator import calibrated
    from hidden.measurement import Active, record
    from hidden.plants import paper_plant
    from hidden.setup import draw_setup

    from invid.recording import write_recording

    rng = np.random.default_rng(25)
    plant = paper_plant(rng)
    setup = draw_setup(rng, plant, moves=False, periods=periods, from_rest=False, drive="sampled", noise=2e-3)
    active: list[Active] = []
    for axis in range(3):
        for name, target in friction:
            active.append(calibrated(rng, setup, CATALOGUE[name], axis, 1, -1, target))
    for name, axis, target in faults:
        active.append(calibrated(rng, setup, CATALOGUE[name], axis, 1, -1, target))
    recording, _, _ = record(rng, setup, tuple(active), [len(m) for m in plant.chains.masses])
    write_recording(recording, place)


def aperiodic(place: Path) -> None:
    """Two chirps of 10 s at 2 kHz of one axis of two masses, dry and viscous friction at the motor."""
    from benchmarks.shared import plant_oracle as oracle
    from invid.recording import write_recording
    from invid.recording.model import Experiment, Kind, Recording, Role

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
    import yaml

    from benchmarks.frozen.cases import _import

    chart = yaml.safe_load((ROOT / "configs" / "import" / "flexible_drive.yaml").read_text(encoding="utf-8"))
    del chart["axes"][0]["masses"]
    with tempfile.TemporaryDirectory() as name:
        unknown = Path(name) / "map.yaml"
        unknown.write_text(yaml.safe_dump(chart), encoding="utf-8")
        source = ROOT.parent / "shared" / "data" / "flexible_drive" / "MultisineTypeB.mat"
        if not source.exists():
            source = ROOT.parents[1] / "shared" / "data" / "flexible_drive" / "MultisineTypeB.mat"
        _import(source, unknown, place)


def large(count: int) -> Callable[[Path], None]:
    """``count`` axes of three masses, every one shaken; 20 s an experiment."""

    def make(place: Path) -> None:
        from benchmarks.identification.bench_identify import measure
        from benchmarks.shared import plant_oracle as oracle
        from invid.recording import write_recording

        rng = np.random.default_rng(0)
        plant = oracle.random_plant(rng, [3] * count)
        mass, _, stiffness, _ = plant.matrices
        top = float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())) / 2 / np.pi
        peak = 10.0 * np.array([sum(m) for m in plant.masses])
        recording = measure(plant, rng, period=10_000, periods=2, settle=3, band=(0.3, 1.25 * top), peak=peak)
        write_recording(replace(recording, masses_per_axis=(3,) * count), place)

    return make


def growth(periods: int) -> Callable[[Path], None]:
    """One axis of two masses, ``periods`` periods of 20 s in one experiment: longer, nothing else."""

    def make(place: Path) -> None:
        from benchmarks.identification.bench_identify import measure
        from benchmarks.shared import plant_oracle as oracle
        from invid.recording import write_recording

        plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.8]], coulomb=(0.6,))
        recording = measure(
            plant, np.random.default_rng(0), period=20_000, periods=periods, settle=1, band=(0.3, 13.0),
            peak=np.array([20.0]), bits=19, noise=0.002,
        )  # fmt: skip
        write_recording(replace(recording, masses_per_axis=(2,)), place)

    return make


CASES: dict[str, Callable[[Path], None]] = {
    "plain": partial(cell, friction=(), faults=(), periods=2),
    "dry": partial(cell, friction=FRICTION[:1], faults=(), periods=2),
    "demo": demo, "rubbing": partial(cell, faults=()), "cell": cell,
    "aperiodic": aperiodic, "bench": bench, "six": large(6), "eight": large(8),
    "growth40": growth(2), "growth80": growth(4), "growth160": growth(8), "help": lambda _: None,
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


def helped() -> dict[str, Any]:
    """What the command uses to print its help, from its start."""
    import resource

    subprocess.run([sys.executable, "-m", "invid", "--help"], check=True, stdout=subprocess.DEVNULL)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = used.ru_utime + used.ru_stime
    return {"cpu_s": seconds, "peak_MB": used.ru_maxrss / 1024, "answer": [], "numpy": []}


def timed(task: str, recording: Path, model: Path) -> dict[str, Any]:
    """Runs one task in this process, bound to one core; what it used and what it answered."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    import resource
    import warnings

    from invid.diagnosis.diagnose import diagnose  # imports count for the start, not here
    from invid.identification.identify import identify
    from invid.model.document import load_model, save_model
    from invid.recording import read_recording

    yardstick = reference()
    if task == "help":
        return {**helped(), "reference_s": yardstick}
    data = read_recording(recording)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        given = load_model(model) if task == "diagnose" and model.exists() else None
        started = time.process_time()
        if task == "identify":
            found = identify(data)
            answer = [" ".join(str(n) for n in found.chains.masses_per_branch)]
            answer += [] if found.fit.get("trustworthy", True) else ["not trustworthy"]
            save_model(found, model)
        else:
            made = diagnose(data, model=given)
            answer = [str(made.verdict), *(f"{f.cause}@{f.axis}" for f in made.findings)]
        used = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    runtime = sorted({str(w.message) for w in said if issubclass(w.category, RuntimeWarning)})
    return {"cpu_s": used, "reference_s": yardstick, "peak_MB": peak, "answer": answer, "numpy": runtime}


def run(case: str, cache: Path, seconds: float) -> dict[str, dict[str, Any]]:
    """All tasks of a case, each in a process of its own."""
    recording, model = cache / f"{case}.h5", cache / f"{case}.model.json"
    if case != "help" and not recording.exists():
        print(f"{case}: making the recording", file=sys.stderr, flush=True)
        CASES[case](recording)
    model.unlink(missing_ok=True)
    tasks = ["diagnose"] if case in ALONE else ["help" if case == "help" else "identify"]
    tasks += ["diagnose"] if case not in (*ALONE, *IDENTIFIED, "help") else []
    found = {}
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    path = os.pathsep.join(str(ROOT / p) for p in (".", "drivers", "service"))
    for task in tasks:
        command = [sys.executable, __file__, "--task", task, str(recording), str(model)]
        environment = {**os.environ, **threads, "PYTHONPATH": path}
        try:
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=seconds)
        except subprocess.TimeoutExpired:
            found[task] = {"failed": f"not done after {seconds:g} s"}
            continue
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            found[task] = {"failed": done.stderr.strip().splitlines()[-1:] or "no answer"}
        else:
            found[task] = json.loads(lines[-1])
    return found


def row(case: str, task: str, now: dict[str, Any], before: dict[str, Any] | None) -> str:
    """One line of the table."""
    if "failed" in now:
        return f"{case:<10} {task:<9} {now['failed']}"
    bar = BARS.get((case, task))
    missed = " MISSED" if bar is not None and now["cpu_s"] > bar else ""
    against = "" if bar is None else f" (bar {bar:g}){missed}"
    old = "" if not before or "failed" in before else f" before {before['cpu_s']:.2f} s,"
    numpy = "".join(f" NUMPY: {w}" for w in now["numpy"])
    ratio = now["cpu_s"] / now["reference_s"]
    return (
        f"{case:<10} {task:<9}{old} {now['cpu_s']:8.2f} s{against}, {ratio:.2f} × reference, "
        f"{now['peak_MB']:.0f} MB: {' '.join(now['answer'])}{numpy}"
    )


def main() -> int:
    """See the module's docstring; exit status 1 where a bar is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; all without")
    parser.add_argument("--task", help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--timeout", type=float, default=1800.0, help="wall seconds that one task may take")
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    parser.add_argument("--cache", type=Path, default=home / "invid-speed")
    options = parser.parse_args()
    if options.task:
        print(json.dumps(timed(options.task, Path(options.cases[0]), Path(options.cases[1]))))
        return 0
    unknown = [c for c in options.cases if c not in CASES]
    if unknown:
        raise SystemExit(f"{unknown[0]}: no case; there are {', '.join(CASES)}")
    options.cache.mkdir(parents=True, exist_ok=True)
    before = json.loads(options.against.read_text(encoding="utf-8")) if options.against else {}
    table: dict[str, dict[str, Any]] = {}
    missed = False
    for case in options.cases or CASES:
        table[case] = run(case, options.cache, options.timeout)
        for task, now in table[case].items():
            print(row(case, task, now, before.get(case, {}).get(task)), flush=True)
            missed |= "failed" in now or now["cpu_s"] > BARS.get((case, task), np.inf)
    if options.output:
        kept = json.loads(options.output.read_text(encoding="utf-8")) if options.output.exists() else {}
        options.output.write_text(json.dumps({**kept, **table}, indent=1, ensure_ascii=False))
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
