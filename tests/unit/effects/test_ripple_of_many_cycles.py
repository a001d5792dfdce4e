"""Ripples of which the motion passes many: their number is read from the spectrum over position."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from two_masses import DAMPER, MASS, SPRING
from two_masses import recording as recording_of

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Role
from invid.recording.model import Experiment, Kind

STEP, PERIOD, NOISE, HOLD, RATE = 0.002, 2048, 0.02, 60.0, 6.0
SUB = 5

Law = Callable[[float, float], tuple[float, float]]
"""Torques that act on motor and load for their positions."""


def swings(seed: int, role: Role, key: str, law: Law) -> Experiment:
    """Three periods, the last two recorded, of a held axis that swings by a radian; classical Runge-Kutta."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 100, 2)
    bins = np.zeros(PERIOD // 2 + 1, complex)
    weight = np.where(lines < 6, 30.0, 0.5)
    bins[lines] = np.exp(2j * np.pi * rng.random(lines.size)) * PERIOD / 2 * weight
    push = np.tile(np.fft.irfft(bins), 4)
    h = STEP / SUB

    def slope(x: np.ndarray, torque: float) -> np.ndarray:
        near, far = law(x[0], x[1])
        damping = DAMPER * (x[2] - x[3])
        return np.array([x[2], x[3], (torque + near - damping) / MASS[0], (far + damping) / MASS[1]])

    x = np.zeros(4)
    position, torque = np.empty(push.size), np.empty(push.size)
    for n, wanted in enumerate(push):
        position[n], torque[n] = x[0], wanted - HOLD * x[0] - RATE * x[2]
        for _ in range(SUB):
            a = slope(x, torque[n])
            b = slope(x + h / 2 * a, torque[n])
            c = slope(x + h / 2 * b, torque[n])
            d = slope(x + h * c, torque[n])
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
    position, torque = position[2 * PERIOD :], torque[2 * PERIOD :]
    return Experiment(
        key=key,
        kind=Kind.MULTISINE,
        role=role,
        excited_axis=0,
        hold_gain=np.array([np.nan]),
        period_samples=PERIOD,
        frequencies_hz=lines / (PERIOD * STEP),
        sample_rate_hz=1.0 / STEP,
        time=np.arange(position.size, dtype=np.float64) * STEP,
        position=(position + 1e-6 * rng.standard_normal(position.size))[:, None],
        torque=(torque + NOISE * rng.standard_normal(torque.size))[:, None],
        torque_demand=torque[:, None],
    )


def cogging(near: float, far: float) -> tuple[float, float]:
    spring = SPRING * (near - far)
    return -spring - 0.8 * np.sin(31 * near + 0.4), spring


def transmission_error(near: float, far: float) -> tuple[float, float]:
    spring = SPRING * (near - far - 8e-4 * np.sin(17 * near + 0.4))
    return -spring * (1 - 8e-4 * 17 * np.cos(17 * near + 0.4)), spring


@pytest.mark.parametrize(
    ("law", "main", "size", "cycles"),
    [
        pytest.param(cogging, "torque", 0.8, 31.0, marks=pytest.mark.campaign),
        pytest.param(transmission_error, "amplitude", 8e-4, 17.0, marks=pytest.mark.campaign),
    ],
)
def test_a_ripple_of_many_cycles_is_found_with_their_number(
    law: Law, main: str, size: float, cycles: float
) -> None:
    recording = recording_of(swings(1, Role.IDENTIFY, "000", law), swings(2, Role.VALIDATE, "001", law))
    motion = recording.experiments[0].position[:, 0]
    assert cycles * motion.std() > 8.0  # radians of phase: beyond what is tried one by one
    diagnosis = diagnose(recording)
    assert diagnosis.verdict is Verdict.EXPLAINED
    (finding,) = diagnosis.findings
    assert finding.effect.cause == law.__name__
    assert finding.effect.parameters["cycles_per_rev"].value == pytest.approx(cycles, rel=2e-3)
    assert finding.effect.parameters[main].value == pytest.approx(size, rel=0.03)
