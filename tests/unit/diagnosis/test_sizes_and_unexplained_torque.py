"""A law that leaves torque beyond the noise is no surer of its size than of what it leaves."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.selection import ERROR_KINDS, Selection
from invid.effects.registry import BY_CAUSE


@dataclass(frozen=True)
class _Fit:
    candidate: Any
    covariance: np.ndarray
    layout: Any


@dataclass(frozen=True)
class _Trial:
    fit: _Fit
    beyond_noise: float = 0.0
    cost: float = 0.0


def _widened(cause: str, x: list[float], left: float, took: float) -> np.ndarray:
    effect = BY_CAUSE[cause]
    term = SimpleNamespace(effect=effect, size=len(x))
    layout = SimpleNamespace(count=2)
    none = _Trial(_Fit(SimpleNamespace(terms=(), x=()), np.eye(2), layout))
    final = _Trial(
        _Fit(SimpleNamespace(terms=(term,), x=(np.array(x),)), 1e-6 * np.eye(2 + len(x)), layout), left
    )
    step = SimpleNamespace(gain=took)
    selection: Any = Selection(none, final, (step,))  # type: ignore[arg-type]
    wider: np.ndarray = selection.widen_by_remainder().final.fit.covariance
    return np.sqrt(np.diag(wider) - 1e-6)


def test_a_fifth_of_the_torque_left_is_a_ninth_of_the_size() -> None:
    std = _widened("cubic_stiffness", [5.6e5], left=0.04e6, took=1e6)
    assert std == pytest.approx([0.0, 0.0, 0.2 * 5.6e5 / np.sqrt(ERROR_KINDS)])


def test_nothing_left_adds_nothing() -> None:
    assert _widened("coulomb_friction", [2.0], left=0.0, took=1e4) == pytest.approx([0.0, 0.0, 0.0])


def test_a_wave_of_one_quadrature_has_the_other_uncertain_too_and_keeps_its_period() -> None:
    std = _widened("cogging", [3.0, 4.0, np.log(24.0)], left=1e4, took=1e6)
    assert std[2:] == pytest.approx([0.5 / np.sqrt(ERROR_KINDS), 0.5 / np.sqrt(ERROR_KINDS), 0.0])


def test_a_gap_moves_as_its_logarithm_and_a_delay_as_itself() -> None:
    assert _widened("backlash", [np.log(1e-3)], 1e4, 1e6)[2] == pytest.approx(0.1 / np.sqrt(ERROR_KINDS))
    assert _widened("torque_delay", [0.006], 1e4, 1e6)[2] == pytest.approx(6e-4 / np.sqrt(ERROR_KINDS))


def test_no_more_than_the_whole_is_left() -> None:
    assert _widened("coulomb_friction", [2.0], left=9e9, took=1.0)[2] == pytest.approx(
        2.0 / np.sqrt(ERROR_KINDS)
    )
