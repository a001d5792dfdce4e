"""What a cause has to gain where the records as a whole are at their noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.acceptance import is_accepted
from invid.diagnosis.evidence import is_significant_at_shapes, is_size_significant
from invid.effects.registry import BY_CAUSE
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Place


def _trial(cost: float, held: float, *, size: float = 0.0, std: float = 1.0) -> Any:
    term = PlacedEffect(BY_CAUSE["torque_gain"], Place("axis", 0))
    candidate = Candidate((term,), (np.array([size]),)) if size else Candidate()
    covariance = np.array([[std**2]])
    fit = SimpleNamespace(cost=cost, dof=2000, candidate=candidate, covariance_of=lambda _: covariance)
    return SimpleNamespace(
        fit=fit,
        held=SimpleNamespace(cost=held, dof=1000),
        cost=cost + held,
        dof=3000,
        x=np.array([size]),
        term=term,
        starts=0,
    )


@pytest.mark.parametrize(("std", "there"), [(0.022, True), (0.055, False)])
def test_a_gain_that_a_few_lines_make_is_no_cause_where_nothing_is_missing(std: float, there: bool) -> None:
    """A 12-bit encoder without dither: a torque scale of 0.81 gained 74, 3.4 deviations by the scatter."""
    before, after = _trial(1990.0, 990.0), _trial(1940.0, 966.0, size=-0.19, std=std)
    state = {"first": True, "rejects": False, "quiet": True}
    assert is_accepted(before, after, (1.0, 1.0), 60, before, **state) is there


def test_a_size_is_told_where_only_its_phase_is_not() -> None:
    """Cycles that are not told turn sine and cosine into each other; how large they are together is known."""
    term = PlacedEffect(BY_CAUSE["transmission_error"], Place("spring", 0, 1))
    size, turn = np.array([6e-5, 2e-5, np.log(15.0)]), np.array([-2e-5, 6e-5, 0.1])
    covariance = np.diag([1.6e-11, 1.6e-11, 1e-6]) + np.outer(turn, turn)
    fit: Any = SimpleNamespace(
        candidate=Candidate((term,), (size,)), covariance_of=lambda _: covariance, layout=None
    )
    assert is_significant_at_shapes(fit, -1, 1e-6)
    covariance[:2, :2] *= 1e4
    covariance[:2, 2] *= 1e2
    covariance[2, :2] *= 1e2
    assert is_significant_at_shapes(fit, -1, 1e-6) is False
    assert is_size_significant(fit, -1, 1e-6) is False


def test_what_a_slider_remembers_raises_what_its_cause_has_to_gain() -> None:
    before, after = _trial(1990.0, 990.0), _trial(1975.0, 981.0, size=1.0, std=0.1)
    state = {"first": True, "rejects": True, "quiet": False}
    assert is_accepted(before, after, (1.0, 1.0), 1, before, **state)
    after.starts = 5
    assert not is_accepted(before, after, (1.0, 1.0), 1, before, **state)
