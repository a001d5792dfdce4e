"""Everything that a fit has found, as one vector with its covariance, and functions of it with deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.shapes import Curvature, curvature
from invid.model.document import Estimate
from invid.model.plant import Structure
from invid.numerics.arrays import Float64

STEP = 1e-4
"""Relative step of the differences by which deviations pass to a cause's own parameters."""


@dataclass(frozen=True, eq=False)
class Quantities:
    """Everything that a fit has found as one vector with its covariance, looked up by name."""

    now: FittedHypothesis
    around: Curvature

    @classmethod
    def of(cls, now: FittedHypothesis) -> Quantities:
        """At a fit."""
        return cls(now, curvature(now))

    def coefficient(self, name: object) -> int | None:
        """Index of a law's coefficient; ``None`` where it is at a bound."""
        at = [c.name for c in self.now.fit.problem.columns].index(name)
        where = np.flatnonzero(self.around.free == at)
        return self.around.numbers + int(where[0]) if where.size else None

    def fitted(self, name: object) -> float:
        """A law's coefficient."""
        names = [c.name for c in self.now.fit.problem.columns]
        return float(self.now.fit.value.coefficients[names.index(name)])

    def shape(self, name: object) -> int:
        """Index of a shape."""
        names = [s.name for s in self.around.shapes]
        return self.around.numbers + self.around.free.size + names.index(name)

    @property
    def values(self) -> Float64:
        """All values in the order of the covariance."""
        coefficients = self.now.fit.value.coefficients[self.around.free]
        shapes = [s.get(self.now.hypothesis) for s in self.around.shapes]
        return np.concatenate((self.now.numbers.x, coefficients, shapes))

    def estimate(
        self, size: Callable[[Float64], float], indices: Sequence[int | None], unit: str | None
    ) -> Estimate:
        """A function of some of the values, with its deviation to first order; absent ones are zero."""
        known = [k for k in indices if k is not None]
        values = self.values[known]
        place = [i for i, k in enumerate(indices) if k is not None]

        def at(moved: Float64) -> float:
            full = np.zeros(len(indices))
            full[place] = moved
            return size(full)

        slope = np.zeros(len(known))
        for i, value in enumerate(values):
            step = STEP * max(abs(float(value)), 1e-6)
            up, down = values.copy(), values.copy()
            up[i] += step
            down[i] -= step
            slope[i] = (at(up) - at(down)) / (2 * step)
        block = self.around.covariance[np.ix_(known, known)]
        deviation = float(np.sqrt(max(float(slope @ block @ slope), 0.0)))
        return Estimate(float(at(values)), deviation if np.isfinite(deviation) else None, unit)


def axis_and_element(structure: Structure, spot: Spot) -> tuple[int, str]:
    """Axis and the contract's element of a place."""
    if spot.where is Where.MOTOR:
        return spot.number, "mass 1"
    first = structure.links[spot.number][0] if spot.where is Where.SPRING else spot.number
    axis = structure.axis_of(first)
    if first >= sum(structure.sizes):
        return axis, "base" if first - sum(structure.sizes) == len(structure.modes) else "mode"
    number = first - structure.motor[axis] + 1
    return axis, f"{'spring' if spot.where is Where.SPRING else 'mass'} {number}"
