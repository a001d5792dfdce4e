"""A motion that still settles is told from a process that scatters."""

from __future__ import annotations

import numpy as np
import pytest
from two_masses import held
from two_masses import recording as recording_of

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording import Role
from invid.recording.model import Experiment, Kind

STEP, PERIOD, NOISE, HOLD = 0.002, 2048, 0.05, 40.0


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


def test_the_noise_floor_of_a_record_from_rest_is_that_of_its_sensors() -> None:
    """Two periods whose motion dies away differ from each other: that is no noise."""
    recording = recording_of(from_rest(1, Role.IDENTIFY, "000"), from_rest(2, Role.VALIDATE, "001"))
    diagnosis = diagnose(recording)
    assert diagnosis.verdict is Verdict.CONSISTENT
    (residual,) = diagnosis.residual
    # White noise of two averaged periods on the lines in use: 60 excited ones, their gaps, a fifth above.
    lines = 1.2 * 119
    expected = NOISE * np.sqrt(2 * lines / (2 * PERIOD))
    assert residual.noise_floor == pytest.approx(expected, rel=0.15)
    assert residual.after == pytest.approx(expected, rel=0.15)
