"""Causes chosen one by one, and the fit with all of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence, Step
from invid.diagnosis.score_test import Score
from invid.likelihood.placed_effect import PlacedEffect
from invid.numerics.arrays import Float64

ERROR_KINDS = 3.0
"""Number of independent errors that the remainder is taken to consist of, one of them along the effect
itself. Empirical: with as many as there are lines (as χ²/ν assumes) a stiffening spring had a standard
deviation of 5 of 5.6e5 while a fifth of its torque was left."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The result of a forward selection: fit without causes, fit with all, and the steps between."""

    base: CandidateEvidence
    final: CandidateEvidence
    steps: tuple[Step, ...] = ()
    rejected: tuple[Score, ...] = field(default=())
    is_cut_short: bool = False
    """Whether the budget ended the search."""
    only_independent: bool = False
    """Whether it holds only causes that stand on their own evidence (``rules.own_evidence``)."""

    def without_causes(self) -> Selection:
        """The selection with none of its causes."""
        return replace(self, final=self.base, steps=())

    def widen_covariance(self, shift: Float64) -> Selection:
        """The selection with the covariance of its final fit widened by the outer product of ``shift``
        (n,)."""
        fit = self.final.fit
        if not shift.size:
            return self
        covariance = fit.covariance + np.outer(shift, shift)
        return replace(self, final=replace(self.final, fit=replace(fit, covariance=covariance)))

    def widen_by_remainder(self) -> Selection:
        """The selection with the size of each cause uncertain by the remainder beyond noise over what it
        explains.

        The remainder shows that a law errs, and it may err along itself as well, where nothing shows it.
        """
        fit, known = self.final.fit, len(self.base.fit.candidate.terms)
        found = fit.candidate.terms[known:]
        shift = np.zeros(fit.covariance.shape[0])
        at = fit.layout.count + sum(t.size for t in fit.candidate.terms[:known])
        for step, term, x in zip(self.steps, found, fit.candidate.x[known:], strict=False):
            took = max(step.gain, 1e-300)
            share = float(np.sqrt(min(self.final.beyond_noise / took, 1.0) / ERROR_KINDS))
            size = _size_change(term, x)
            shift[at : at + size.size] = share * size
            at += term.size
        covariance = fit.covariance + np.diag(shift**2)
        return replace(self, final=replace(self.final, fit=replace(fit, covariance=covariance)))


def _size_change(term: PlacedEffect, x: Float64) -> Float64:
    """(k,) change of the parameters that hold an effect's size which doubles it."""
    effect, count = term.effect, len(term.effect.coefficients)
    if effect.coefficients == ("sine", "cosine"):
        return np.full(2, float(np.hypot(*x[:2])))
    if count == 0 and effect.logarithmic[:1] == (True,):
        return np.ones(1)
    out: Float64 = np.abs(x[: max(count, 1)])
    return out
