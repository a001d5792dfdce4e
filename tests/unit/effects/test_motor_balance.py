"""Friction of a motor that stops, stands and turns round follows from what acts on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from invid.effects.laws.motor_balance import follow_motor

STEP, FINE = 2e-3, 400
INERTIA = 1.5


@dataclass(frozen=True)
class Motor:
    """What a motor did in one closed period: (n,) each, the drive's torque held over each sample."""

    velocity: np.ndarray
    drive: np.ndarray
    spring: np.ndarray
    friction: np.ndarray
    stood: float


def _friction(v: np.ndarray | float, low: float, high: float, excess: float, width: float) -> np.ndarray:
    """Coulomb levels of both directions and a Stribeck part."""
    level = np.where(np.asarray(v) > 0, high, -low) + excess * np.exp(-((np.asarray(v) / width) ** 2))
    return level * np.sign(v)


def _motor(seed: int, peak: float, low: float, high: float, excess: float = 0.0, width: float = 1.0) -> Motor:
    """A motor beside a moving spring's end, marched in 400 steps a sample until its period repeats."""
    rng = np.random.default_rng(seed)
    count = 500
    time = np.arange(count) * STEP
    lines = rng.integers(1, 24, 8)
    phases = rng.uniform(0, 2 * np.pi, (2, 8))
    waves = [np.sin(2 * np.pi * lines * time[:, None] + p).sum(axis=1) for p in phases]
    drive = peak * waves[0] / np.abs(waves[0]).max()
    fine = np.arange(count * FINE) * (STEP / FINE)
    spring = 0.2 * peak * np.sin(2 * np.pi * 3.0 * fine + 1.0)
    v, h = 0.0, STEP / FINE
    for _ in range(2):  # the first period ends where the second begins
        velocity, friction, stood = np.zeros(count), np.zeros(count), 0
        for k in range(count):
            velocity[k] = v
            for j in range(FINE):
                acting = drive[k] + spring[k * FINE + j]
                free = v + h * acting / INERTIA
                if v == 0.0:
                    most, least = high + excess, low - excess
                else:
                    most, least = (
                        float(_friction(np.sign(v) * max(abs(v), 1e-12), low, high, excess, width)),
                    ) * 2
                held = free * INERTIA / h  # what would stop it within this step
                force = min(max(held, least), most) if v == 0.0 else most
                if v != 0.0 and v * (v + h * (acting - force) / INERTIA) < 0.0:
                    force = held
                v += h * (acting - force) / INERTIA
                if abs(v) < 1e-14:
                    v = 0.0
                stood += v == 0.0
                friction[k] += force / FINE
    return Motor(velocity, drive, spring[::FINE], friction, stood / (count * FINE))


def _followed(
    motor: Motor, velocity: np.ndarray, law: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean friction and share of holding of a motor whose ``velocity`` is measured."""
    slow = 0.02
    speeds = np.linspace(1e-9, 1.0, 33) * slow
    moving, forward, backward = (_friction(v, *law, 1.0) for v in (velocity, speeds, -speeds))
    drive = np.stack((motor.drive,) * 2, axis=1)
    found: tuple[np.ndarray, np.ndarray] = follow_motor(
        velocity, moving, drive, motor.spring, forward, backward, slow, 1.0 / INERTIA, STEP
    )
    return found


@pytest.mark.parametrize(
    ("peak", "low", "high", "excess"),
    [(30.0, -12.0, 20.0, 0.0), (30.0, -10.0, 10.0, 8.0)],
)
def test_a_motor_that_stands_is_held_by_what_acts_on_it(
    peak: float, low: float, high: float, excess: float
) -> None:
    seed = 1
    motor = _motor(seed, peak, low, high, excess)
    assert motor.stood > 0.01
    noisy = motor.velocity + 1e-4 * np.random.default_rng(seed).standard_normal(motor.velocity.size)
    mean, share = _followed(motor, noisy, (low, high, excess))
    by_sign = np.where(noisy > 0, high + excess, low - excess)
    error, plain = np.std(mean - motor.friction), np.std(by_sign - motor.friction)
    assert error < 0.02 * (high - low), (error, plain)
    assert error < 0.2 * plain, (error, plain)
    assert share.mean() == pytest.approx(motor.stood, abs=0.02)
