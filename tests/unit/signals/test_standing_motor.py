"""A motor that stands is told from one that only turns round, as far as noise lets it."""

from __future__ import annotations

import numpy as np

from invid.signals.standstill import is_seen_standing

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


def test_a_motor_that_stops_is_seen_to_stand() -> None:
    velocity, _, resistance = _driven(1.3 * DRY)
    assert 0.3 < (np.abs(resistance) < 0.999 * DRY).mean() < 0.8
    assert is_seen_standing(velocity, 1e-3 * float(np.abs(velocity).max()))
