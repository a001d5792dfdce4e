"""Identification against its statistical limit, on plants simulated by code it does not use.

    python benchmarks/identification/bench_identify.py [--case NAME] [--draws N] [--seed0 S]

Without --case every case runs with its full number of draws (hours on one core). Every figure is printed
beside its bar, every draw that misses it with its seed. Exit status 1 where a bar is missed.

white     case study, all axes at once, white noise: error / Cramér-Rao bound, coverage of ±1σ and ±2σ
friction  section 4 from rest, 30 s in all, Coulomb friction 3 % of the peak torque, 18 bits, 1 ms late
creep     the same with a peak of twice the Coulomb torque on a slow creep of every axis
rubbing   one axis with Coulomb friction: do the stated standard deviations hold?
random    M = 1…4, N = 2…5, unequal and equal branches, zero and negative couplings: found or flagged
large     M = 8, N = 3 and M = 6, N = 5: time and accuracy
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.shared import plant_oracle as oracle
from invid.errors import NotIdentifiableError
from invid.identification.begun import settled_about
from invid.identification.fitted_model import chains_covariance
from invid.identification.identify import identify
from invid.identification.kept_out import all_records
from invid.identification.open_holds import open_masses
from invid.model.chains import CoupledChains
from invid.model.document import Model, parameter_vector
from invid.recording.model import Experiment, Kind, Recording, Role

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
    creep: float = 0.0,
    late: int = 0,
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
        # A creep: the hold follows a reference that runs away, gain·v·t + damping·v of further torque.
        run = creep * np.arange(demand.shape[0]) / RATE
        demand = demand + run[:, None] * gain + creep * damping
        position, torque = oracle.simulate(plant, demand, RATE, gain=gain, damping=damping, in_drive=False)
        if late:  # the torque in the record is that of some samples ago
            torque = np.concatenate((np.repeat(torque[:1], late, axis=0), torque[:-late]))
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
    """Cramér-Rao standard deviations: true plant, true white noise, timing and friction unknown."""
    records = []
    for r in all_records(recording):
        share = 4.0 * r.step / r.span
        level = share * np.full(peak.size, position) ** 2, share * (noise * peak) ** 2
        records.append(replace(r, position_noise=level[0], torque_noise=level[1]))
    couplings = np.zeros((peak.size, peak.size))
    for (i, j), value in plant.couplings.items():
        couplings[i, j] = couplings[j, i] = value
    chains = CoupledChains.build(plant.masses, plant.springs, plant.dampers, couplings, axes=recording.axes)
    end = settled_about(chains, records)
    settled, covariance = chains_covariance(end, recording.axes, open_masses(end))
    deviation = dict(zip(parameter_vector(settled)[0], np.sqrt(np.diag(covariance)), strict=True))
    ordered = [n for kind in (".mass.", ".spring.", ".coupling") for n in deviation if kind in n]
    return np.array([deviation[n] for n in ordered])


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
    print(f"white: stated/CRB {np.median(ratios):.3f}")
    return covered("white", np.array(deviations), np.array(errors))


def covered(name: str, z: np.ndarray, e: np.ndarray) -> bool:
    """Coverage of the stated standard deviations and error over the bound, beside their bars."""
    one, two = float(np.mean(np.abs(z) < 1)), float(np.mean(np.abs(z) < 2))
    slack = 3 * np.sqrt(0.22 / z.size)  # three standard deviations of a share of 0.68 of z.size
    over, bar = float(np.sqrt(np.mean(e**2))), 3 / np.sqrt(2 * e.size)
    print(
        f"{name}: {z.shape[0]} seeds: error/CRB {over:.3f} (bar 1.1 ± {bar:.2f}), ±1σ {one:.3f} (0.63–0.73 ± "
        f"{slack:.2f}), ±2σ {two:.3f} (0.92–0.98 ± {slack / 2:.2f}), z rms {np.sqrt(np.mean(z**2)):.2f}"
    )
    inside = 0.63 - slack < one < 0.73 + slack and 0.92 - slack / 2 < two < 0.98 + slack / 2
    return over < 1.1 + bar and inside


def friction(seeds: range) -> bool:
    """30 s of robot time in all, from rest, Coulomb friction 3 % of the peak torque, torque 1 ms late."""
    peak = np.array([20.0, 40.0, 60.0])
    return section4("friction", seeds, peak, 0.03 * peak, bar=0.003, share=0.95)


def creep(seeds: range) -> bool:
    """The same with a peak of twice the Coulomb torque, and every axis creeping.

    The creep is two and a half times as fast as the excitation's own motion (0.13–0.2 rad/s rms), so that the
    motors hardly ever turn back: 5 rad in a record. At 0.3 rad/s they do 1–7 % of the time, and two of three
    seeds had a parameter off by 1.2–1.6 %; at 0.15 rad/s 4–6 %.
    """
    peak = np.array([20.0, 40.0, 60.0])
    return section4("creep", seeds, peak, 0.5 * peak, bar=0.01, share=0.9, speed=0.5)


def section4(
    name: str,
    seeds: range,
    peak: np.ndarray,
    coulomb: np.ndarray,
    *,
    bar: float,
    share: float,
    speed: float = 0.0,
) -> bool:
    """All 18 parameters below ``bar`` in ``share`` of the seeds; median error against the bound."""
    plant = oracle.case_study(coulomb=tuple(coulomb))
    good, worst, over, z = 0, [], [], []
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
            creep=speed,
            late=1,
        )
        values, std = estimate(identify(recording, masses=(3, 3, 3)))
        error = float(np.abs(values / truth(plant) - 1).max())
        # 18 bits are 24 µrad: uniform rounding has a standard deviation of a √12th of that.
        limit = bound(plant, recording, peak, 0.005, 2 * np.pi / 2**18 / np.sqrt(12))
        over.append(float(np.sqrt(np.mean(((values - truth(plant)) / limit) ** 2))))
        worst.append(error)
        z.append((values - truth(plant)) / std)
        good += error < bar
        if error >= bar:
            print(f"{name}: seed {seed}: worst parameter off by {error:.2%}", flush=True)
    reached, ratio = good / len(seeds), float(np.median(over))
    rms = float(np.sqrt(np.mean(np.array(z) ** 2)))
    print(
        f"{name}: {len(seeds)} seeds: all 18 < {bar:.1%} in {reached:.0%} (bar {share:.0%}), median worst "
        f"{np.median(worst):.3%}, median error/CRB {ratio:.2f} (bar 2.5), z rms {rms:.2f}"
    )
    return reached >= share and (ratio < 2.5 or bool(speed))


def rubbing(seeds: range) -> bool:
    """One axis with Coulomb friction, steady: are the stated standard deviations true?"""
    plant = oracle.OraclePlant([[1.0, 2.0]], [[1500.0]], [[0.8]], coulomb=(0.6,))
    z = []
    for seed in seeds:
        recording = measure(
            plant,
            np.random.default_rng(seed),
            period=8000,
            periods=3,
            settle=2,
            band=(0.3, 13.0),
            peak=np.array([20.0]),
            bits=19,
            noise=0.002,
        )
        values, std = estimate(identify(recording, masses=(2,)))
        z.append((values - truth(plant)) / std)
    rms = float(np.sqrt(np.mean(np.array(z) ** 2)))
    print(f"rubbing: {len(seeds)} seeds: z rms {rms:.2f} (bar 1.3: friction is no white noise)")
    return rms < 1.3


def random(seeds: range) -> bool:
    """Random plants: found, flagged, or silently wrong."""
    found = flagged = silent = 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        sizes = [int(n) for n in rng.integers(2, 6, int(rng.integers(1, 5)))]
        if seed % 10 == 9:  # equal branches, one in ten
            sizes = [sizes[0]] * len(sizes)
        plant = oracle.random_plant(rng, sizes)
        if seed % 10 == 9:
            plant = replace(
                plant,
                masses=[plant.masses[0]] * len(sizes),
                springs=[plant.springs[0]] * len(sizes),
                dampers=[plant.dampers[0]] * len(sizes),
                couplings=dict.fromkeys(plant.couplings, 0.0 if seed % 20 == 9 else 0.2),
            )
        mass, _, stiffness, _ = plant.matrices
        top = float(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).max())) / 2 / np.pi
        peak = 10.0 * np.array([sum(m) for m in plant.masses])
        recording = measure(
            plant, rng, period=10_000, periods=2, settle=2, band=(0.3, 1.25 * top), peak=peak, bits=20
        )
        try:
            model = identify(recording, masses=sizes)
        except NotIdentifiableError as error:
            flagged += 1
            print(f"random: seed {seed}, N {sizes}: refused: {str(error)[:100]}", flush=True)
            continue
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
                f"{np.nanmax(relative):.2%}, {np.nanmax(z):.1f} σ",
                flush=True,
            )
        else:
            flagged += 1
            print(f"random: seed {seed}, N {sizes}: flagged: {model.warnings[-1][:100]}", flush=True)
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
            # One draw of some dozens of parameters: the bar and three standard deviations of an rms.
            passed &= took < 60 and over < 1.2 * (1 + 3 / np.sqrt(2 * values.size))
    return passed


CASES = {
    "white": (white, 100),
    "friction": (friction, 40),
    "creep": (creep, 40),
    "rubbing": (rubbing, 20),
    "random": (random, 200),
    "large": (large, 1),
}


def main() -> int:
    """Run the cases asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", choices=CASES)
    parser.add_argument("--draws", "--seeds", type=int, help="how many seeds; default: the bar's own number")
    parser.add_argument("--seed0", "--first", type=int, default=0)
    arguments, _ = parser.parse_known_args()
    missed = []
    for name, (case, full) in CASES.items():
        if arguments.case in (None, name) and not case(
            range(arguments.seed0, arguments.seed0 + (arguments.draws or full))
        ):
            missed.append(name)
    print(f"bars missed: {', '.join(missed)}" if missed else "all bars met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
