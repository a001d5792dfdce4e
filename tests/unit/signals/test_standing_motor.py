"""A motor that stands is held by whatever acts on it, up to its friction."""

from __future__ import annotations

import numpy as np

from invid.signals.standstill import find_standstill

STEP = 1e-3
MASS, DRY = 0.1, 2.0


def _driven(peak: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity, driving torque and resistance of a sliding mass, sample by sample, in 200 steps each."""
    steps, time = 200, np.arange(1000) * STEP
    torque = peak * np.sin(2 * np.pi * 4.0 * time)
    velocity, resistance, v = np.zeros(time.size), np.zeros(time.size), 0.0
    for k in range(time.size):
        for j in range(steps):
            push = peak * np.sin(2 * np.pi * 4.0 * (time[k] + j * STEP / steps))
            stop = push + MASS * v / (STEP / steps)
            held = float(np.clip(stop, -DRY, DRY))
            v += (push - held) / MASS * STEP / steps
            if j == 0:
                resistance[k] = held
        velocity[k] = v
    return velocity, torque, resistance


def test_what_acts_is_the_resistance_while_it_stands() -> None:
    velocity, torque, resistance = _driven(1.3 * DRY)
    still = find_standstill(velocity, 1e-3 * float(np.abs(velocity).max()))
    assert still is not None
    true = np.abs(resistance) < 0.999 * DRY  # it stands
    assert 0.3 < true.mean() < 0.8
    by_sign = DRY * np.sign(velocity)
    found = still.held(by_sign, torque, -DRY, DRY)
    later = slice(100, None)  # nothing says when a record that starts at rest came to rest
    plain, better = (np.std((wave - resistance)[later]) for wave in (by_sign, found))
    assert better < 0.3 * plain, (better, plain)


def test_a_motor_that_only_reverses_does_not_stand() -> None:
    velocity, _, _ = _driven(6.0 * DRY)
    assert find_standstill(velocity, 1e-3 * float(np.abs(velocity).max())) is None


def test_noise_hides_whether_it_stands() -> None:
    velocity, _, _ = _driven(1.3 * DRY)
    assert find_standstill(velocity, 0.1 * float(np.std(velocity))) is None
