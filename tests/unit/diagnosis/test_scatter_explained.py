"""Scatter between periods that a cause made is no noise once the cause is in the model."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.rules.scatter_explained import quieted

LINES, SENSORS = 400, 1e-4


@dataclass(frozen=True, eq=False)
class _Record:
    omega: np.ndarray
    scatter: np.ndarray
    alone: bool = False
    differs: bool = True


def _part(left: float, scatter: float) -> Any:
    """What a fit leaves: noise of the sensors and ``left`` more, of which ``scatter`` is counted as noise."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2, LINES, 1)) * np.sqrt(0.5 * (SENSORS + left))
    covariance = np.full((LINES, 1, 1), SENSORS + scatter, dtype=complex)
    record: Any = _Record(np.arange(1.0, LINES + 1.0), np.full((LINES, 1), scatter))
    return SimpleNamespace(
        views=(SimpleNamespace(record=record),),
        missing=(noise[0] + 1j * noise[1],),
        covariance=(covariance,),
        roots=(1.0 / np.sqrt(covariance),),
        bases=(np.zeros((2 * LINES, 0)),),
    )


def test_scatter_goes_where_the_cause_leaves_only_the_sensors_noise() -> None:
    (record,) = quieted(_part(0.0, 100.0 * SENSORS))
    assert record.scatter.max() < 0.2 * SENSORS


def test_as_much_stays_as_what_is_left_asks_for() -> None:
    (record,) = quieted(_part(10.0 * SENSORS, 100.0 * SENSORS))
    assert record.scatter.mean() == pytest.approx(10.0 * SENSORS, rel=0.15)
    assert record.differs


def test_scatter_that_is_noise_stays() -> None:
    part = _part(100.0 * SENSORS, 100.0 * SENSORS)
    assert quieted(part)[0] is part.views[0].record
