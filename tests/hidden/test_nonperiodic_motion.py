"""An axis held so softly that it wanders over a ripple does another thing in every period."""

from __future__ import annotations

import numpy as np
import pytest

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Role
from invid.recording.model import Experiment, Kind, Recording

STEP, PERIOD, PERIODS, SUB = 0.002, 2048, 2, 20
MASSES, SPRING, DAMPER = (0.134, 0.041), 400.0, 0.08
LINES = np.arange(3, 120, 2)
RIPPLE, CYCLES, PHASE = 0.1, 52.0, 1.75
HOLD, DRAG = 1.5, 0.02


def _experiment(rng: np.random.Generator, key: str, role: Role, level: float, ripple: float) -> Experiment:
    """Two masses with a ripple at the motor, leapfrog in ``SUB`` steps a sample, torque held over each."""
    bins = np.zeros(PERIOD // 2 + 1, dtype=complex)
    bins[LINES] = np.exp(2j * np.pi * rng.random(LINES.size)) * PERIOD / 2
    wave = np.fft.irfft(bins)
    push = level * wave / np.std(wave)
    h, (m1, m2) = STEP / SUB, MASSES
    a, b, va, vb = 0.0, 0.0, 0.0, 0.0
    position, torque = np.zeros((2 + PERIODS) * PERIOD), np.zeros((2 + PERIODS) * PERIOD)
    for k in range(position.size):
        position[k] = a
        torque[k] = command = push[k % PERIOD] - HOLD * a
        for _ in range(SUB):
            a, b = a + 0.5 * h * va, b + 0.5 * h * vb
            between = SPRING * (a - b) + DAMPER * (va - vb)
            va += h * (command - between - DRAG * va - ripple * np.sin(CYCLES * a + PHASE)) / m1
            vb += h * between / m2
            a, b = a + 0.5 * h * va, b + 0.5 * h * vb
    position += 1e-5 * rng.standard_normal(position.size)
    torque += 1e-3 * rng.standard_normal(torque.size)
    kept = slice(2 * PERIOD, None)
    return Experiment(
        key=key,
        kind=Kind.MULTISINE,
        role=role,
        excited_axis=0,
        hold_gain=np.array([HOLD]),
        period_samples=PERIOD,
        frequencies_hz=LINES / (PERIOD * STEP),
        sample_rate_hz=1.0 / STEP,
        time=np.arange(position.size)[kept] * STEP,
        position=position[kept, None],
        torque=torque[kept, None],
    )


def _recording(ripple: float) -> Recording:
    rng = np.random.default_rng(2)
    experiments = (
        _experiment(rng, "000", Role.IDENTIFY, 0.4, ripple),
        _experiment(rng, "001", Role.VALIDATE, 0.3, ripple),
    )
    return Recording(
        source="memory",
        created="2026-11-22T00:00:00Z",
        robot="r",
        axes=("A1",),
        position_unit="rad",
        torque_unit="N·m",
        masses_per_axis=(2,),
        experiments=experiments,
    )


def test_a_ripple_over_which_the_axis_wanders_is_followed_period_by_period() -> None:
    """Every period is another one: their mean shows nothing, and what differs is 200 times the noise."""
    found = diagnose(_recording(RIPPLE))
    ripple, grease = found.findings
    assert (ripple.effect.cause, grease.effect.cause) == ("cogging", "viscous_friction")
    value = ripple.effect.value
    assert value("torque") == pytest.approx(RIPPLE, rel=0.02)
    assert value("cycles_per_rev") == pytest.approx(CYCLES, rel=0.002)
    assert value("phase") == pytest.approx(PHASE, abs=0.03)
    assert grease.effect.value("coefficient") == pytest.approx(DRAG, rel=0.05)
    assert found.verdict is Verdict.EXPLAINED
