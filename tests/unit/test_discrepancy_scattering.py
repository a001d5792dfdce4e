"""Torque that differs from period to period is no noise, and a model that misses it explains nothing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from hidden.generator import make

from invid.diagnosis import Verdict
from invid.discrepancy import diagnose
from invid.discrepancy.scattering import said_of_scatter
from invid.recording.model import Recording


def _part(scatter: float) -> Any:
    lines = 40
    record = SimpleNamespace(
        omega=2 * np.pi * np.arange(lines),
        scatter=np.full((lines, 1), scatter),
        weight=np.zeros(0),
        set_aside=np.zeros(0, dtype=bool),
    )
    covariance = np.full((lines, 1, 1), 1.0 + scatter, dtype=complex)
    return SimpleNamespace(views=[SimpleNamespace(record=record)], covariance=(covariance,))


@pytest.mark.parametrize(("scatter", "said"), [(0.0, False), (4.0, False), (99.0, True)])
def test_what_differs_between_periods_by_far_more_than_noise_is_said(scatter: float, said: bool) -> None:
    recording: Any = SimpleNamespace(axes=("A1",), axis_count=1)
    found = said_of_scatter((_part(scatter),), recording, "N·m")
    assert (found is not None) is said
    if found is not None:
        assert "10 times what its sensors' noise makes" in found.sentence
        assert found.character == ("time-dependent",)


def _disturbed(recording: Recording, size: float) -> Recording:
    """The machine under a slow random torque that its drives report: its periods differ."""
    rng = np.random.default_rng(3)
    out = []
    for e in recording.experiments:
        wave = np.convolve(rng.standard_normal(e.samples), np.hanning(25), mode="same")[:, None]
        out.append(replace(e, torque=e.torque + size * wave * float(np.std(e.torque)), torque_demand=None))
    return replace(recording, experiments=tuple(out))


def test_torque_that_never_repeats_is_not_called_consistent() -> None:
    recording, _ = make(None, seed=11, motors=1, periods=4, from_rest=False, moves=False)
    assert diagnose(recording).verdict is Verdict.CONSISTENT
    found = diagnose(_disturbed(recording, 0.1))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.findings == ()
