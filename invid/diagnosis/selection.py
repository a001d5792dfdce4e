"""Causes chosen one by one, and where that ended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence, Step
from invid.diagnosis.score_test import Score
from invid.likelihood.placed_effect import PlacedEffect
from invid.numerics.arrays import Float64

ALIKE = 3.0
"""As many kinds of error as what is left is taken for, one of which would be the effect's own. A guess. With
as many as there are lines, which is what χ²/ν takes it for, a spring that stiffens was known to 5 of 5.6e5,
and a fifth of its torque was left."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Where forward selection ended."""

    base: CandidateEvidence
    final: CandidateEvidence
    steps: tuple[Step, ...] = ()
    rejected: tuple[Score, ...] = field(default=())
    cut: bool = False
    """Whether the budget ended the search before it ended by itself."""
    partly: bool = False
    """Whether only those causes are in it that stand on their own evidence (``rules.own_evidence``)."""

    def wider(self, shift: Float64) -> Selection:
        """The same with parameters of the final fit that may be off by ``shift`` (n,) besides their noise."""
        fit = self.final.fit
        if not shift.size:
            return self
        covariance = fit.covariance + np.outer(shift, shift)
        return replace(self, final=replace(self.final, fit=replace(fit, covariance=covariance)))

    def as_far_as_explained(self) -> Selection:
        """The same with the size of each cause uncertain by what is left beyond noise, over what it took.

        What a law leaves shows that it errs, and it may err along itself as well, where nothing shows it.
        """
        fit, known = self.final.fit, len(self.base.fit.candidate.terms)
        found = fit.candidate.terms[known:]
        shift = np.zeros(fit.covariance.shape[0])
        at = fit.layout.count + sum(t.size for t in fit.candidate.terms[:known])
        for step, term, x in zip(self.steps, found, fit.candidate.x[known:], strict=False):
            took = max(step.before.cost - step.chosen.cost, 1e-300)
            share = float(np.sqrt(min(self.final.beyond_noise / took, 1.0) / ALIKE))
            size = _size(term, x)
            shift[at : at + size.size] = share * size
            at += term.size
        covariance = fit.covariance + np.diag(shift**2)
        return replace(self, final=replace(self.final, fit=replace(fit, covariance=covariance)))


def _size(term: PlacedEffect, x: Float64) -> Float64:
    """(k,) change of the first parameters, those that say how large an effect is, that doubles it."""
    effect, count = term.effect, len(term.effect.coefficients)
    if effect.coefficients == ("sine", "cosine"):
        return np.full(2, float(np.hypot(*x[:2])))
    if count == 0 and effect.logarithmic[:1] == (True,):
        return np.ones(1)
    out: Float64 = np.abs(x[: max(count, 1)])
    return out
