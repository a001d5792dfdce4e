"""Velocity of motors from counts, between the samples too, whether the record closes or not."""

from __future__ import annotations

import numpy as np
import pytest

from invid.signals.motor_motion import motor_motion

STEP, COUNT, FINER = 0.002, 4000, 3


def _motion(time: np.ndarray, drift: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity: sinusoids up to 12 Hz that close after the record, a slow one does not."""
    hz = np.array([0.5, 1.75, 4.125, 12.0])
    turns = 2 * np.pi * hz * time[:, None] + np.arange(4)
    slow = 2 * np.pi * 0.0731 * time
    position = (np.array([0.2, 0.1, 0.05, 0.003]) * np.sin(turns)).sum(axis=1) + drift * np.sin(slow)
    rate = (2 * np.pi * hz * np.array([0.2, 0.1, 0.05, 0.003]) * np.cos(turns)).sum(axis=1)
    return position, rate + drift * 2 * np.pi * 0.0731 * np.cos(slow)


@pytest.mark.parametrize(("drift", "closes"), [(0.0, True), (0.3, False)])
def test_the_velocity_is_right_at_the_ends_and_between_the_samples(drift, closes) -> None:
    time = np.arange(COUNT) * STEP
    wave = _motion(time, drift)[0][:, None]
    found = motor_motion(
        wave, STEP, np.full(1, 1e-16), round(12.0 * COUNT * STEP), FINER * COUNT, closes=closes
    )
    fine = np.arange(FINER * COUNT) * STEP / FINER
    position, velocity = _motion(fine, drift)
    inside = fine <= time[-1]
    assert np.abs(found.velocity[inside, 0] - velocity[inside]).max() < 0.03 * velocity.std()
    assert np.abs(found.position[inside, 0] - position[inside]).max() < 1e-3 * position.std()
    middle = slice(FINER * COUNT // 20, -FINER * COUNT // 20)
    assert np.abs(found.velocity[middle, 0] - velocity[middle]).max() < 2e-3 * velocity.std()


def test_noise_is_not_differentiated() -> None:
    time = np.arange(COUNT) * STEP
    position, velocity = _motion(time, 0.0)
    noise = 1e-4 * np.random.default_rng(1).standard_normal(COUNT)
    level = np.full(1, 4 * 1e-8 / COUNT)
    found = motor_motion((position + noise)[:, None], STEP, level, 96, COUNT, closes=True)
    plain = np.gradient(position + noise, STEP) - velocity
    assert np.std(found.velocity[:, 0] - velocity) < 0.02 * plain.std()
    assert found.unseen[200:].mean() > 0.99
