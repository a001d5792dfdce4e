"""Images of a torque that is held over each sample fold onto the lines of sampled motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from invid.signals.spectral_record import Images

STEP = 1e-3
MASSES, SPRING, DAMPER = (0.02, 0.05), 300.0, 0.05


def _sampled(omega: np.ndarray, late: float) -> np.ndarray:
    """Motor position over torque of two masses as a sampled system, torque held from t = kh + late."""
    m, k, d = np.diag(MASSES), SPRING * np.array([[1, -1], [-1, 1]]), DAMPER * np.array([[1, -1], [-1, 1]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(m, k), -np.linalg.solve(m, d)]])
    b = np.array([0.0, 0.0, 1.0 / MASSES[0], 0.0])

    def held(t: float) -> tuple[np.ndarray, np.ndarray]:
        both = expm(np.block([[a, b[:, None]], [np.zeros((1, 5))]]) * t)
        return both[:4, :4], both[:4, 4]

    after, with_new = held(STEP - late)
    before, with_old = held(late)
    whole = after @ before
    z = np.exp(1j * omega * STEP)
    drive = after @ with_old / z[:, None] + with_new
    return np.linalg.solve(z[:, None, None] * np.eye(4) - whole, drive[..., None])[:, 0, 0]


@pytest.mark.parametrize("late", [0.0, 0.2e-3, 0.7e-3])
def test_sampled_motion_under_a_held_torque_is_the_continuous_one_and_its_images(late: float) -> None:
    hz = np.array([5.0, 20.0, 60.0, 140.0, 200.0])
    omega = 2 * np.pi * hz
    s = 1j * omega
    link = SPRING + DAMPER * s
    stiffness = MASSES[0] * s**2 + link - link**2 / (MASSES[1] * s**2 + link)
    held = np.sinc(hz * STEP) * np.exp(-s * (STEP / 2 + late))
    plain = _sampled(omega, late)
    images = Images.of(omega, STEP).at(np.array([late]))[:, 0] / MASSES[0]
    left = np.abs(stiffness * (plain - images) - held)
    missed = np.abs(stiffness * plain - held)
    assert missed[-1] > 5e-3
    assert left.max() < 0.01 * missed[-1]
    assert left[3] < 0.02 * missed[3]
