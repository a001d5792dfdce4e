"""A cause that the others leave nothing to is no finding, in whatever order they were found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.evidence import Step, Trial
from invid.diagnosis.rules import pruning
from invid.diagnosis.selection import Selection
from invid.effects.registry import BY_CAUSE
from invid.likelihood.placed_effect import Candidate, Term
from invid.model.place import Place

SPRING = Term(BY_CAUSE["coupling_stiffness"], Place("pair", 0, other=1))
RIPPLE = Term(BY_CAUSE["transmission_error"], Place("spring", 1, 2))
X = {SPRING: np.array([12.8]), RIPPLE: np.array([5e-7, 1e-7, 6.4])}


def _trial(cost: float, *terms: Term) -> Any:
    """A fit in which the spring is known to 0.2 %, the ripple to 40 %."""
    candidate = Candidate(terms, tuple(X[t] for t in terms))
    blocks = {SPRING: np.array([[4e-4]]), RIPPLE: np.diag([4e-14, 4e-14, 1e-4])}
    fit = SimpleNamespace(
        cost=cost,
        dof=1600,
        p=np.zeros(3),
        layout=None,
        candidate=candidate,
        covariance_of=lambda number: blocks[terms[number]],
    )
    return Trial(fit=fit, held=SimpleNamespace(cost=530.0, dof=540))  # type: ignore[arg-type]


@pytest.mark.parametrize(("without", "kept"), [(1560.0, 1), (1900.0, 2)])
def test_the_last_cause_goes_where_the_others_do_as_well_from_where_it_led_them(
    monkeypatch: pytest.MonkeyPatch, without: float, kept: int
) -> None:
    base, first, last = _trial(4e5), _trial(1900.0, SPRING), _trial(1552.0, SPRING, RIPPLE)
    steps = (Step(base, first, ((first, 0.0),)), Step(first, last, ((last, 0.0),)))

    def fit(layout: Any, records: Any, p: Any, candidate: Candidate, **_: Any) -> Any:
        return _trial(without if candidate.terms == (SPRING,) else 4e5, *candidate.terms).fit

    monkeypatch.setattr(pruning, "fit", fit)
    monkeypatch.setattr("invid.diagnosis.evidence.held_out", lambda *_: base.held)
    found = pruning.pruned(Selection(base, last, steps), [], [])
    assert [s.chosen.term.effect.cause for s in found.steps] == ["coupling_stiffness", "transmission_error"][
        :kept
    ]
