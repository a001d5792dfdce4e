"""What columns beside a fit explain that nothing else in it does, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.shapes import joint_rows
from invid.likelihood.unknown_forces.value import bounded_minimum
from invid.numerics.arrays import Float64

ALIKE = 1e-4
"""Share of a law's power that nothing else in the fit explains, below which it is none of its own: motion is
known to a thousandth, so a hundredth of a law's size (its square) is the least that is not made of that."""


@dataclass(frozen=True, eq=False)
class Background:
    """What else a fit moves: by how much −2 ln L falls with columns beside it, all else moving to first
    order."""

    rows: tuple[Float64, ...]
    """(rows, p + J') of each stack."""
    left: tuple[Float64, ...]
    """(rows,) missing torque of each stack."""
    size: Float64
    inverse: Float64

    @classmethod
    def of(cls, now: FittedHypothesis) -> Background:
        """At a fit, with strengths as they are."""
        value, joint = now.fit.value, now.fit.slope.joint
        size: Float64 = np.sqrt(np.diag(joint)) + 1e-300
        inverse = np.asarray(
            np.linalg.inv(joint / size[:, None] / size + 1e-10 * np.eye(size.size)), dtype=np.float64
        )
        return cls(
            tuple(joint_rows(now, k) for k in range(len(value.work))),
            tuple((w.missing + w.laws @ value.coefficients).ravel() for w in value.work),
            size,
            inverse,
        )

    def beside(self, columns: Sequence[Float64]) -> tuple[Float64, Float64]:
        """(k, k) and (k,): what of whitened columns (rows, k) of each stack nothing else explains, and their
        pull."""
        count = columns[0].shape[1]
        own, cross, pull = np.zeros((count, count)), np.zeros((self.size.size, count)), np.zeros(count)
        for rows, rest, flat in zip(self.rows, self.left, columns, strict=True):
            own += flat.T @ flat
            cross += rows.T @ flat
            pull += flat.T @ rest
        cross = cross / self.size[:, None]
        return own - cross.T @ self.inverse @ cross + ALIKE * np.diag(np.diag(own) + 1e-300), pull


def bounded_fall(own: Float64, pull: Float64, limits: Sequence[tuple[float, float]]) -> float:
    """Largest −2·pull·β − βᵀ·own·β with β within its limits."""
    low, high = np.array(limits).T
    beta, _ = bounded_minimum(own, pull, (low, high))
    return float(-2.0 * pull @ beta - beta @ own @ beta)
