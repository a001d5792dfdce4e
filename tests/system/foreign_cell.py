"""A measurement made by somebody else: numpy, scipy and h5py only, nothing of invid.

Writes recordings in the contract's shape with only the attributes that are not optional, the way a
stranger's program would: bytes or str attributes, int32 or int64, its own plant simulation (exact
discretisation of the linear part by the matrix exponential, ten sub-steps a sample, hold loop of the
drive evaluated every sub-step).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.linalg import block_diag, expm

SUBSTEPS = 10


@dataclass
class Plant:
    """Full matrices and the rows of the motors."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    motors: list[int]
    coulomb: list[float] = field(default_factory=list)
    rounding: float = 1e-4
    """Velocity over which Coulomb friction changes sign [rad/s]."""


def chain(values: list[float]) -> np.ndarray:
    """Stiffness (or damping) matrix of one chain."""
    size = len(values) + 1
    matrix = np.zeros((size, size))
    for q, value in enumerate(values):
        matrix[q : q + 2, q : q + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


def plant(
    masses: list[list[float]],
    springs: list[list[float]],
    couplings: dict[tuple[int, int], float],
    damping_ratio: float = 0.01,
) -> Plant:
    """Parallel chains with coupled final masses; modal damping ``damping_ratio`` near 30 rad/s."""
    mass = np.diag([m for branch in masses for m in branch])
    ends = np.cumsum([len(b) for b in masses]) - 1
    for (i, j), value in couplings.items():
        mass[ends[i], ends[j]] = mass[ends[j], ends[i]] = value
    stiffness = block_diag(*[chain(k) for k in springs])
    damping = 2 * damping_ratio / 35.0 * stiffness
    return Plant(mass, damping, stiffness, [0, *(ends[:-1] + 1).tolist()])


def case_study_plant() -> Plant:
    """Section 4 of the paper, as numbers."""
    return plant(
        [[0.7, 2, 3], [4, 5, 6], [7, 8, 9]],
        [[1000, 2000], [3000, 4000], [5000, 6000]],
        {(0, 1): 1.0, (0, 2): 2.0, (1, 2): 3.0},
    )


def random_odd_multisine(
    rng: np.random.Generator, period: int, rate: float, band: tuple[float, float], peak: float
) -> tuple[np.ndarray, np.ndarray]:
    """One period of a random-phase odd multisine and its lines; amplitude falls as f^-1/2."""
    lines = np.arange(1, period // 2, 2)
    hz = lines * rate / period
    hz = hz[(hz >= band[0]) & (hz <= band[1])]
    t = np.arange(period) / rate
    best = None
    for _ in range(30):
        phase = rng.uniform(0, 2 * np.pi, hz.size)
        wave = (hz[:, None] ** -0.5 * np.cos(2 * np.pi * hz[:, None] * t + phase[:, None])).sum(0)
        if best is None or np.abs(wave).max() / wave.std() < np.abs(best).max() / best.std():
            best = wave
    assert best is not None
    return peak * best / np.abs(best).max(), hz


def simulate(
    p: Plant,
    excitation: np.ndarray,
    rate: float,
    hold: np.ndarray,
    hold_damping: np.ndarray,
    *,
    staircase: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Motor positions and torques (n, M) for an excitation (n, M) added to each motor's hold torque.

    ``staircase``: the excitation is constant over each sample; otherwise interpolated linearly.
    """
    count, motors = excitation.shape[0], p.motors
    dofs = p.mass.shape[0]
    inverse = np.linalg.inv(p.mass)
    a = np.block([[np.zeros((dofs, dofs)), np.eye(dofs)], [-inverse @ p.stiffness, -inverse @ p.damping]])
    b = np.zeros((2 * dofs, len(motors)))
    b[dofs:] = inverse[:, motors]
    h = 1.0 / rate / SUBSTEPS
    block = expm(np.block([[a, b], [np.zeros((len(motors), a.shape[0] + len(motors)))]]) * h)
    ad, bd = block[: a.shape[0], : a.shape[0]], block[: a.shape[0], a.shape[0] :]
    velocity_rows = [dofs + m for m in motors]
    coulomb = np.array(p.coulomb or [0.0] * len(motors))
    x = np.zeros(2 * dofs)
    position, torque = np.empty_like(excitation), np.empty_like(excitation)
    if staircase and not coulomb.any():
        # Everything is linear: the ten sub-steps of a sample are one matrix.
        feedback = np.zeros((len(motors), 2 * dofs))
        feedback[range(len(motors)), motors] = hold
        feedback[range(len(motors)), velocity_rows] = hold_damping
        closed = ad - bd @ feedback
        powers = [np.linalg.matrix_power(closed, s) for s in range(SUBSTEPS + 1)]
        a_sample, b_sample = powers[-1], sum(powers[:-1]) @ bd
        for k in range(count):
            position[k], torque[k] = x[motors], excitation[k] - feedback @ x
            x = a_sample @ x + b_sample @ excitation[k]
        return position, torque
    for k in range(count):
        following = excitation[k + 1] if k + 1 < count else excitation[k]
        for s in range(SUBSTEPS):
            drive = excitation[k] if staircase else excitation[k] + (following - excitation[k]) * s / SUBSTEPS
            motor = drive - hold * x[motors] - hold_damping * x[velocity_rows]
            if s == 0:
                position[k], torque[k] = x[motors], motor
            friction = coulomb * np.tanh(x[velocity_rows] / p.rounding)
            x = ad @ x + bd @ (motor - friction)
    return position, torque


def write_recording(
    path: Path,
    experiments: list[dict[str, Any]],
    axes: list[str],
    *,
    position_unit: str = "rad",
    torque_unit: str = "N·m",
) -> None:
    """The contract's file, with required attributes only."""
    with h5py.File(path, "w") as f:
        f.attrs["format"] = "invid-recording"
        f.attrs["format_version"] = np.int32(1)
        f.attrs["created"] = "2026-11-21T08:00:00Z"
        f.attrs["robot"] = "somebody else's robot"
        f.attrs["axes"] = json.dumps(axes)
        f.attrs["position_unit"] = position_unit
        f.attrs["torque_unit"] = torque_unit
        for number, e in enumerate(experiments):
            group = f.create_group(f"experiments/{number:03d}")
            for name, value in e["attributes"].items():
                group.attrs[name] = value
            for name in ("time", "position", "torque"):
                group.create_dataset(name, data=e[name])


def measure(
    p: Plant,
    rng: np.random.Generator,
    *,
    peak: list[float],
    rate: float = 1000.0,
    period: int = 10_000,
    settle_periods: int = 1,
    periods: int = 3,
    band: tuple[float, float] = (0.3, 13.0),
    staircase: bool = True,
    torque_noise: float = 0.005,
    bits: int = 19,
    validate: bool = True,
    hold_gain: float = 300.0,
) -> list[dict[str, Any]]:
    """One experiment an excited axis, all axes held by PD inside the drives, then one for validation."""
    count = len(p.motors)
    mass = np.array([p.mass[m, m] for m in p.motors])
    hold = np.full(count, hold_gain)
    damping = 2 * 0.5 * np.sqrt(hold * mass)
    runs = [(i, "identify", 1.0) for i in range(count)]
    if validate:
        runs += [(i, "validate", 0.6) for i in range(count)]
    out = []
    for axis, role, scale in runs:
        wave, hz = random_odd_multisine(rng, period, rate, band, scale * peak[axis])
        excitation = np.zeros((period * (settle_periods + periods), count))
        excitation[:, axis] = np.tile(wave, settle_periods + periods)
        position, torque = simulate(p, excitation, rate, hold, damping, staircase=staircase)
        keep = slice(settle_periods * period, None)
        step = 2 * np.pi / 2**bits
        noisy = np.round(position[keep] / step) * step
        noise = np.array(peak) * torque_noise
        out.append(
            {
                "attributes": {
                    "kind": "multisine",
                    "excited_axis": np.int64(axis),
                    "role": np.bytes_(role),
                    "hold_gain": hold,
                    "period_samples": np.int32(period),
                    "frequencies_hz": hz,
                    "sample_rate_hz": rate,
                },
                "time": np.arange(noisy.shape[0]) / rate,
                "position": noisy,
                "torque": torque[keep] + noise * rng.standard_normal(noisy.shape),
            }
        )
    return out
