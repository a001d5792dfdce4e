"""A drive that smooths the torque it reports is no fault of the machine, and hides none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hidden.generator import make
from hidden.scoring import score
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.recording.model import Experiment, Recording

SAMPLES = 2.0
"""Time constant of the drive's filter in samples."""


def _reported(e: Experiment) -> Experiment:
    """The record as a drive reports it through a first-order lag, settled; no demand logged."""
    lines = 2 * np.pi * np.fft.rfftfreq(e.samples)
    spectrum = np.fft.rfft(e.torque, axis=0) / (1.0 + 1j * lines[:, None] * SAMPLES)
    return replace(e, torque=np.fft.irfft(spectrum, e.samples, axis=0), torque_demand=None)


def _smoothed(recording: Recording) -> Recording:
    return replace(recording, experiments=tuple(_reported(e) for e in recording.experiments))


@pytest.mark.parametrize("seed", [11, 12])
def test_an_empty_record_with_smoothed_torque_is_consistent(seed: int) -> None:
    recording, _ = make(None, seed=seed, motors=1, drive="smooth", moves=False, from_rest=False)
    diagnosis = diagnose(_smoothed(recording))
    assert diagnosis.verdict is Verdict.CONSISTENT
    assert not diagnosis.findings


def test_friction_is_named_with_its_size_behind_smoothed_torque() -> None:
    recording, truth = make(
        "coulomb_friction", seed=13, target_db=25.0, masses=(2,), drive="smooth", moves=False, from_rest=False
    )
    found = score(truth, diagnose(_smoothed(recording)))
    assert found.outcome == "right"
    assert found.size_error == pytest.approx(0.0, abs=0.05)
