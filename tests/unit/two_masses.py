"""A two-mass axis integrated exactly for torque held over the sample: shares nothing with ``invid`` but the
containers."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from invid.recording.model import Experiment, Recording

MASS, SPRING, DAMPER = np.array([0.7, 2.0]), 1000.0, 0.5


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
