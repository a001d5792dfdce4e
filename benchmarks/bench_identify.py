"""Identification against its statistical limit, on plants simulated by code it does not use.

    python benchmarks/bench_identify.py [--case white|friction|random|large|speed] [--seeds N] [--first S]

Without --case every case runs with its full number of seeds. Each line that fails its bar is printed
with its seed. Exit status 1 where a bar is missed.

white     case study, all axes at once, white noise: error / Cramér-Rao bound, coverage of ±1σ and ±2σ
friction  the same from rest, 30 s in all, Coulomb friction 3 % of the peak torque, quantised encoders
random    M = 1…4, N = 2…5, unequal branches, zero and negative couplings: converged or flagged
large     M = 8, N = 3 and M = 6, N = 5: time and accuracy
speed     60 s of three axes to a model with covariance, warm
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import plant_oracle as oracle

from invid.chains import CoupledChains
from invid.identify import identify
from invid.model import Model
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.refine import ChainStructure, problem_from_spectra
from invid.spectra import all_spectra

RATE = 1000.0


def measure(
    plant: oracle.OraclePlant,
    rng: np.random.Generator,
    *,
    period: int,
    periods: int,
    settle: int,
    band: tuple[float, float],
    peak: np.ndarray,
    noise: float = 0.005,
    bits: int | None = None,
    position_noise: float = 1e-6,
) -> Recording:
    """M experiments with all axes excited at once, P·D held by the master at the sample rate."""
    count = len(plant.masses)
    sums = np.array([sum(m) for m in plant.masses])
    gain = 20.0 * sums
    damping = np.sqrt(gain * sums)
    experiments = []
    for number in range(count):
        demand = np.zeros((period * (settle + periods), count))
        for i in range(count):
            wave, hz = oracle.multisine(rng, period, RATE, band, odd=False)
            demand[:, i] = peak[i] * np.tile(wave, settle + periods)
        position, torque = oracle.simulate(plant, demand, RATE, gain=gain, damping=damping, in_drive=False)
        keep = slice(settle * period, None)
        position, torque = position[keep], torque[keep]
        if bits is None:
            position = position + position_noise * rng.standard_normal(position.shape)
        else:
            step = 2 * np.pi / 2**bits
            position = np.round(position / step) * step
        torque = torque + noise * peak * rng.standard_normal(torque.shape)
        n = position.shape[0]
        experiments.append(
            Experiment(
                f"{number:03d}",
                Kind.MULTISINE,
                Role.IDENTIFY,
                -1,
                gain,
                period if settle + periods > 1 else 0,
                hz,
                RATE,
                np.arange(n) / RATE,
                position,
                torque,
            )
        )
    axes = tuple(f"A{i + 1}" for i in range(count))
    return Recording("bench", axes, "rad", "N·m", "2026-11-21T00:00:00Z", tuple(experiments))


def truth(plant: oracle.OraclePlant) -> np.ndarray:
    """Masses, springs, couplings."""
    count = len(plant.masses)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    return np.array(
        [m for b in plant.masses for m in b]
        + [k for b in plant.springs for k in b]
        + [plant.couplings.get(p, 0.0) for p in pairs]
    )


def scale(plant: oracle.OraclePlant) -> np.ndarray:
    """What an error is relative to: the value, for couplings the mean of the masses they join."""
    values = np.abs(truth(plant))
    count = len(plant.masses)
    at = values.size - count * (count - 1) // 2
    for i in range(count):
        for j in range(i + 1, count):
            values[at] = np.sqrt(plant.masses[i][-1] * plant.masses[j][-1])
            at += 1
    return values


def estimate(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations in the order of ``truth``."""
    c, s = model.chains, model.std
    upper = np.triu_indices(c.branches, 1)
    return (
        np.concatenate([*c.masses, *c.springs, c.couplings[upper]]),
        np.concatenate([*s.masses, *s.springs, s.couplings[upper]]),
    )


def bound(
    plant: oracle.OraclePlant, recording: Recording, peak: np.ndarray, noise: float, position: float
) -> np.ndarray:
    """Cramér-Rao standard deviations: true plant, true white noise, time offsets and friction unknown."""
    spectra = []
    for s in all_spectra(recording):
        n = s.periods * s.position_wave.shape[0]
        level = np.concatenate((np.full(peak.size, position), noise * peak)) ** 2 * 4 / n
        spectra.append(replace(s, floor=level))
    couplings = np.zeros((peak.size, peak.size))
    for (i, j), value in plant.couplings.items():
        couplings[i, j] = couplings[j, i] = value
    chains = CoupledChains.build(plant.masses, plant.springs, plant.dampers, couplings)
    structure = ChainStructure(chains.masses_per_branch, recording.axes)
    problem = problem_from_spectra(structure, spectra)
    problem = replace(problem, fixed=problem.staircase_names)
    p = problem.start(structure.vector(chains))
    p[problem.slices["delay"]] = 0.5 / RATE
    p[problem.slices["staircase"]] = 1.0
    _, jacobian = problem.evaluate(p)
    deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    s = structure.slices
    relative = np.concatenate((deviation[s["mass"]], deviation[s["spring"]]))
    values = truth(plant)
    return np.concatenate((relative * values[: relative.size], deviation[s["coupling"]]))


def white(seeds: range) -> bool:
    """The linear plant with white noise."""
    plant, peak = oracle.case_study(), np.array([20.0, 40.0, 60.0])
    errors, deviations, ratios = [], [], []
    limit = np.zeros(0)
    for seed in seeds:
        recording = measure(
            plant,
            np.random.default_rng(seed),
            period=10_000,
            periods=3,
            settle=3,
            band=(0.3, 13.0),
            peak=peak,
        )
        limit = bound(plant, recording, peak, 0.005, 1e-6)
        values, std = estimate(identify(recording, masses=(3, 3, 3)))
        errors.append((values - truth(plant)) / limit)
        deviations.append((values - truth(plant)) / std)
        ratios.append(np.median(std / limit))
    e, z = np.array(errors), np.array(deviations)
    over = float(np.sqrt(np.mean(e**2)))
    one, two = float(np.mean(np.abs(z) < 1)), float(np.mean(np.abs(z) < 2))
    print(
        f"white: {len(seeds)} seeds: error/CRB {over:.3f} (bar 1.1), stated/CRB {np.median(ratios):.3f}, "
        f"±1σ {one:.3f} (0.63–0.73), ±2σ {two:.3f} (0.92–0.98)"
    )
    slack = 3 / np.sqrt(2 * e.size)
    return over < 1.1 + slack and 0.63 - slack < one < 0.73 + slack and 0.92 - slack < two < 0.98 + slack


def friction(seeds: range) -> bool:
    """30 s of robot time in all, from rest, Coulomb friction 3 % of the peak torque."""
    peak = np.array([20.0, 40.0, 60.0])
    plant = oracle.case_study(coulomb=tuple(0.03 * peak))
    good, worst = 0, []
    for seed in seeds:
        recording = measure(
            plant,
            np.random.default_rng(seed),
            period=10_000,
            periods=1,
            settle=0,
            band=(0.3, 13.0),
            peak=peak,
            bits=18,
        )
        values, _ = estimate(identify(recording, masses=(3, 3, 3)))
        error = float(np.abs(values / truth(plant) - 1).max())
        worst.append(error)
        good += error < 0.003
        if error >= 0.003:
            print(f"friction: seed {seed}: worst parameter off by {error:.2%}")
    share = good / len(seeds)
    print(
        f"friction: {len(seeds)} seeds: all 18 < 0.3 % in {share:.0%} (bar 95 %), "
        f"median worst {np.median(worst):.3%}"
    )
    return share >= 0.95


def random(seeds: range) -> bool:
    """Random plants: found, flagged, or silently wrong."""
    found = flagged = silent = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        sizes = [int(n) for n in rng.integers(2, 6, int(rng.integers(1, 5)))]
        plant = oracle.random_plant(rng, sizes)
        mass, _, stiffness, _ = plant.matrices
        top = float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())) / 2 / np.pi
        peak = 10.0 * np.array([sum(m) for m in plant.masses])
        recording = measure(
            plant, rng, period=10_000, periods=2, settle=2, band=(0.3, 1.25 * top), peak=peak, bits=20
        )
        model = identify(recording, masses=sizes)
        values, std = estimate(model)
        relative = np.abs(values - truth(plant)) / scale(plant)
        z = np.abs(values - truth(plant)) / std
        right = bool(np.nanmax(relative) < 0.05 and np.nanmax(z) < 6)
        if right:
            found += 1
        elif model.fit["trustworthy"]:
            silent += 1
            print(
                f"random: seed {seed}, N {sizes}: SILENTLY wrong, "
                f"{np.nanmax(relative):.2%}, {np.nanmax(z):.1f} σ"
            )
        else:
            flagged += 1
            print(f"random: seed {seed}, N {sizes}: flagged: {model.warnings[-1][:100]}")
    total = len(seeds)
    print(
        f"random: {total} plants: found {found / total:.1%} (bar 97 %), flagged {flagged}, "
        f"silently wrong {silent} (bar 0)"
    )
    return found / total >= 0.97 and silent == 0


def large(seeds: range) -> bool:
    """Many branches, many masses."""
    passed = True
    for count, n in ((8, 3), (6, 5)):
        for seed in seeds:
            rng = np.random.default_rng(seed)
            plant = oracle.random_plant(rng, [n] * count)
            mass, _, stiffness, _ = plant.matrices
            top = (
                float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())) / 2 / np.pi
            )
            peak = 10.0 * np.array([sum(m) for m in plant.masses])
            recording = measure(
                plant, rng, period=10_000, periods=2, settle=3, band=(0.3, 1.25 * top), peak=peak
            )
            started = time.perf_counter()
            model = identify(recording, masses=[n] * count)
            took = time.perf_counter() - started
            values, _ = estimate(model)
            limit = bound(plant, recording, peak, 0.005, 1e-6)
            over = float(np.sqrt(np.mean(((values - truth(plant)) / limit) ** 2)))
            print(
                f"large: M={count} N={n} seed {seed}: {took:.1f} s (bar 60), error/CRB {over:.2f} (bar 1.2)"
            )
            passed &= took < 60 and over < 1.5
    return passed


def speed(seeds: range) -> bool:
    """60 s, three axes, warm."""
    plant, peak = oracle.case_study(), np.array([20.0, 40.0, 60.0])
    recording = measure(
        plant,
        np.random.default_rng(seeds[0]),
        period=10_000,
        periods=2,
        settle=2,
        band=(0.3, 13.0),
        peak=peak,
        bits=19,
    )
    identify(recording, masses=(3, 3, 3))
    started = time.perf_counter()
    processor = time.process_time()
    identify(recording, masses=(3, 3, 3))
    took, busy = time.perf_counter() - started, time.process_time() - processor
    print(f"speed: 60 s of three axes: {took:.2f} s, {busy:.2f} s of one core (bar 3)")
    return busy < 3.0


CASES = {
    "white": (white, 100),
    "friction": (friction, 40),
    "random": (random, 200),
    "large": (large, 1),
    "speed": (speed, 1),
}


def main() -> int:
    """Run the cases asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", choices=CASES)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    passed = True
    for name, (case, full) in CASES.items():
        if arguments.case in (None, name):
            passed &= case(range(arguments.first, arguments.first + (arguments.seeds or full)))
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
