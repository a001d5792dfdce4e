"""A two-mass axis integrated exactly for torque held over the sample: shares nothing with ``invid`` but the
containers."""

import numpy as np
from scipy.linalg import expm

from invid.recording.model import Experiment, Kind, Recording, Role

MASS, SPRING, DAMPER = np.array([0.7, 2.0]), 1000.0, 0.5
STEP, PERIOD, NOISE, HOLD = 0.002, 2048, 0.05, 40.0


def held(
    push: np.ndarray, step: float, hold: float, rate: float, beside: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) motor position and torque from rest under ``push`` and a sampled hold, ``hold`` and ``rate`` its
    torque per position and per velocity; ``beside`` acts as well and is not in the torque."""
    beside = np.zeros(push.size) if beside is None else beside
    a = np.zeros((4, 4))
    a[:2, 2:] = np.eye(2)
    a[2:, :2] = SPRING * np.array([[-1, 1], [1, -1]]) / MASS[:, None]
    a[2:, 2:] = DAMPER * np.array([[-1, 1], [1, -1]]) / MASS[:, None]
    b = np.array([0.0, 0.0, 1.0 / MASS[0], 0.0])
    block = expm(np.block([[a, b[:, None]], [np.zeros((1, 5))]]) * step)
    phi, gamma = block[:4, :4], block[:4, 4]
    state = np.zeros(4)
    position, torque = np.empty(push.size), np.empty(push.size)
    for n, wanted in enumerate(push):
        position[n] = state[0]
        torque[n] = wanted - hold * state[0] - rate * state[2]
        state = phi @ state + gamma * (torque[n] + beside[n])
    return position, torque


def from_rest(seed: int, role: Role, key: str) -> Experiment:
    """Two periods from rest of a two-mass axis (0.7 and 2 kg·m², 1000 N·m/rad), softly held."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 120, 2)
    bins = np.zeros(PERIOD // 2 + 1, complex)
    bins[lines] = np.exp(2j * np.pi * rng.random(lines.size)) * PERIOD / 2 * 0.4
    excitation = np.tile(np.fft.irfft(bins), 2)
    position, torque = held(excitation, STEP, HOLD, rate=1.0)
    return Experiment(
        key=key,
        kind=Kind.MULTISINE,
        role=role,
        excited_axis=0,
        hold_gain=np.array([HOLD]),
        period_samples=PERIOD,
        frequencies_hz=lines / (PERIOD * STEP),
        sample_rate_hz=1.0 / STEP,
        time=np.arange(excitation.size) * STEP,
        position=(position + 1e-7 * rng.standard_normal(position.size))[:, None],
        torque=(torque + NOISE * rng.standard_normal(torque.size))[:, None],
        torque_demand=torque[:, None],
    )


def recording(*experiments: Experiment) -> Recording:
    """A recording of the axis, its number of masses declared."""
    return Recording(
        robot="two masses",
        axes=("A1",),
        position_unit="rad",
        torque_unit="N·m",
        created="2026-11-21T10:00:00Z",
        masses_per_axis=(2,),
        experiments=experiments,
    )


def free_multisine(periods: int, count: float) -> tuple[np.ndarray, np.ndarray]:
    """(n,) motor position in counts of ``count`` and torque at 1 kHz, from rest: lines 1 to 79 of a period of
    2048, without a hold; both masses rub on the ground."""
    rng = np.random.default_rng(5)
    m1, m2, k, c, d = 0.7, 2.0, 1000.0, 0.6, 0.5
    speeds = [
        [-k / m1, k / m1, -(c + d) / m1, c / m1, 1 / m1],
        [k / m2, -k / m2, c / m2, -(c + d) / m2, 0],
    ]
    whole = expm(np.array([[0, 0, 1, 0, 0], [0, 0, 0, 1, 0], *speeds, [0] * 5]) * 1e-3)
    phase = rng.uniform(0, 2 * np.pi, 79)
    wave = np.cos(2 * np.pi * np.outer(np.arange(2048) / 2048, np.arange(1, 80)) + phase).sum(axis=1)
    torque = np.tile(np.round(wave / 0.05) * 0.05, periods)
    state, position = np.zeros(5), np.zeros(torque.size)
    for n, u in enumerate(torque):
        state[4], position[n] = u, state[0]
        state = whole @ state
    return np.round((position + rng.normal(0, 0.3 * count, torque.size)) / count) * count, torque
