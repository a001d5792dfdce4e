"""The noise of a record's lines is the sensors', however strong its excitation."""

from __future__ import annotations

import numpy as np
import pytest

from invid.likelihood.prepare_records import spectral_record
from invid.recording.model import Experiment, Kind, Role
from invid.signals.spectra import spectra_of

RATE, COUNT, NOISE = 500.0, 24_000, 1e-2
LINES = np.array([0.5, 1.25, 2.0, 3.5, 5.0])


def pushed(noise: float) -> Experiment:
    """A free mass of 1 kg·m² pushed by 10 N·m a line for 48 s, with white noise on its torque."""
    rng = np.random.default_rng(4)
    time = np.arange(COUNT) / RATE
    turns = 2 * np.pi * LINES * time[:, None] + rng.uniform(0.0, 2 * np.pi, LINES.size)
    torque = 10.0 * np.cos(turns).sum(axis=1)
    position = -(10.0 * np.cos(turns) / (2 * np.pi * LINES) ** 2).sum(axis=1)
    position = position + 1e-6 * rng.standard_normal(COUNT)
    torque = torque + noise * rng.standard_normal(COUNT)
    return Experiment(
        "000", Kind.MULTISINE, Role.IDENTIFY, 0, np.zeros(1), 4000, LINES, RATE, time, position[:, None],
        torque[:, None],
    )  # fmt: skip


def test_many_samples_make_the_noise_of_a_line_small() -> None:
    experiment = pushed(NOISE)
    record = spectral_record(spectra_of(experiment), experiment)
    assert record.noise[1:, 1].mean() == pytest.approx(4 * NOISE**2 / COUNT, rel=0.3)


def test_a_torque_without_noise_is_a_command_and_is_taken_to_have_some() -> None:
    experiment = pushed(0.0)
    record = spectral_record(spectra_of(experiment), experiment)
    assert record.noise[1:, 1] == pytest.approx(1e-8 * 10.0**2, rel=0.01)
