"""Torque that differs from period to period is no noise, and a model that misses it explains nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.rules.nonrepeating_torque import describe_scatter
from invid.likelihood.null_test import _wander_share


def _part(scatter: float) -> Any:
    lines = 40
    record = SimpleNamespace(
        omega=2 * np.pi * np.arange(lines),
        scatter=np.full((lines, 1), scatter),
        weight=np.zeros(0),
        set_aside=np.zeros(0, dtype=bool),
        differs=scatter > 9.0,
    )
    covariance = np.full((lines, 1, 1), 1.0 + scatter, dtype=complex)
    return SimpleNamespace(views=[SimpleNamespace(record=record)], covariance=(covariance,))


@pytest.mark.parametrize(("scatter", "said"), [(0.0, False), (4.0, False), (99.0, True)])
def test_what_differs_between_periods_by_far_more_than_noise_is_said(scatter: float, said: bool) -> None:
    recording: Any = SimpleNamespace(axes=("A1",), axis_count=1)
    found = describe_scatter((_part(scatter),), recording, "N·m")
    assert (found is not None) is said
    if found is not None:
        assert "10 times what its sensors' noise makes" in found.sentence
        assert found.character == ("time-dependent",)


def test_a_held_axis_that_hardly_moves_does_not_wander() -> None:
    motion = np.zeros((5, 2), dtype=complex)
    motion[1:] = [1.0, 1e-6]
    deviations = np.zeros((3, 4, 4), dtype=complex)
    deviations[:, :, 1] = 1e-6 * np.array([1.0, -1.0, 0.0])[:, None]
    record: Any = SimpleNamespace(omega=np.arange(5.0), position=motion)
    driven: Any = SimpleNamespace(deviations=deviations, driven=np.array([True, False]))
    assert _wander_share(record, driven) == 0.0
    deviations[:, :, 0] = 0.3 * np.array([1.0, -1.0, 0.0])[:, None]
    assert _wander_share(record, driven) == pytest.approx(0.3 * np.sqrt(2.0 / 3.0))
