"""Identification against its statistical limit, on plants simulated by code it does not use.

    python benchmarks/identification/bench_identify.py [--draws N] [--seed0 S]

The case study of the paper, all axes at once, white noise: error / Cramér-Rao bound, coverage of ±1σ and ±2σ,
each beside its bar. Exit status 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from benchmarks.shared import plant_oracle as oracle
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


def main() -> int:
    """Run the draws asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", "--seeds", type=int, default=100)
    parser.add_argument("--seed0", "--first", type=int, default=0)
    arguments, _ = parser.parse_known_args()
    met = white(range(arguments.seed0, arguments.seed0 + arguments.draws))
    print("all bars met" if met else "a bar is missed")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
