"""What a cause has to gain where the records as a whole are at their noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.discrepancy.acceptance import accepted
from invid.discrepancy.terms import Candidate, Term
from invid.discrepancy.words import BY_CAUSE
from invid.effects.place import Place


def _trial(cost: float, held: float, *, size: float = 0.0, std: float = 1.0) -> Any:
    term = Term(BY_CAUSE["torque_gain"], Place("axis", 0))
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
    )


@pytest.mark.parametrize(("std", "there"), [(0.022, True), (0.055, False)])
def test_a_gain_that_a_few_lines_make_is_no_cause_where_nothing_is_missing(std: float, there: bool) -> None:
    """A 12-bit encoder without dither: a torque scale of 0.81 gained 74, 3.4 deviations by the scatter."""
    before, after = _trial(1990.0, 990.0), _trial(1940.0, 966.0, size=-0.19, std=std)
    state = {"first": True, "rejects": False, "quiet": True}
    assert accepted(before, after, 1.0, 60, before, **state) is there
