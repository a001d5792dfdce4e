"""Causes chosen one by one, and where that ended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from invid.arrays import Float64
from invid.discrepancy.screen import Score
from invid.discrepancy.trial import Step, Trial


@dataclass(frozen=True, eq=False)
class Selection:
    """Where forward selection ended."""

    base: Trial
    final: Trial
    steps: tuple[Step, ...] = ()
    rejected: tuple[Score, ...] = field(default=())

    def wider(self, shift: Float64) -> Selection:
        """The same with parameters of the final fit that may be off by ``shift`` (n,) besides their noise."""
        fit = self.final.fit
        if not shift.size:
            return self
        covariance = fit.covariance + np.outer(shift, shift)
        return replace(self, final=replace(self.final, fit=replace(fit, covariance=covariance)))
