"""Fit of plant, timing, laws and strengths: Levenberg's steps, strengths renewed between them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.slope import Slope, slope
from invid.likelihood.unknown_forces.strengths import stronger
from invid.likelihood.unknown_forces.value import Numbers, Problem, Value, evaluate
from invid.numerics import budget
from invid.numerics.arrays import Float64

LARGEST_STEP = 0.7
"""Largest step of a number in one iteration: of a logarithm a factor of two."""
TOLERANCE = 1.0
"""Fall of −2 ln L in an iteration below which a fit has arrived: no number would then move by its
deviation."""
TRIALS = 8
FIRST, LESS, MORE, LEAST_DAMPING, RESTART = 1e-2, 0.2, 5.0, 1e-7, 1e-3
"""Damping of numbers scaled to unit curvature: at the start, its factors, its least, and where it begins
again."""


@dataclass(frozen=True, eq=False)
class Fit:
    """The least value found, its slope there, and whether the steps had come to their end."""

    problem: Problem
    value: Value
    slope: Slope
    converged: bool

    @property
    def total(self) -> float:
        """−2 ln L."""
        return self.value.total

    @property
    def numbers(self) -> Numbers:
        """The numbers found."""
        return self.value.numbers

    @property
    def covariance(self) -> Float64:
        """(p, p) covariance of the numbers as they move."""
        unit = np.sqrt(np.diag(self.slope.curvature))
        out: Float64 = np.linalg.inv(self.slope.curvature / unit[:, None] / unit) / unit[:, None] / unit
        return out


def fit(problem: Problem, start: Numbers, iterations: int = 30) -> Fit:
    """The least −2 ln L from ``start``.

    Raises
    ------
    LinAlgError
        No value at the start.
    """
    now = evaluate(problem, start)
    if iterations:
        now = _lowest(now, _with_strengths(problem, now))
    around, damping, converged = slope(problem, now), FIRST, False
    for _ in range(iterations):
        if budget.is_left_out("fits to their end"):
            break
        following, damping = _step(problem, now, around, damping)
        best = _lowest(now, following, _with_strengths(problem, following or now))
        gained, now = now.total - best.total, best
        around = slope(problem, now)
        if gained < TOLERANCE:
            converged = True
            break
    return Fit(problem, now, around, converged)


def _lowest(*values: Value | None) -> Value:
    return min((v for v in values if v is not None), key=lambda v: v.total)


def _with_strengths(problem: Problem, now: Value) -> Value | None:
    """The value with strengths raised and lowered; none where one has grown beyond what a matrix holds."""
    with suppress(np.linalg.LinAlgError):
        return evaluate(problem, stronger(problem, now))
    return None


def _step(problem: Problem, now: Value, around: Slope, damping: float) -> tuple[Value | None, float]:
    """A lower value, where one is found, and the damping for the next step."""
    unit = np.sqrt(np.diag(around.curvature))
    scaled = around.curvature / unit[:, None] / unit
    for _ in range(TRIALS):
        step = -np.linalg.solve(scaled + damping * np.eye(unit.size), around.gradient / unit) / unit
        step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        numbers = now.numbers.moved(now.numbers.x + step)
        if numbers.plant.is_admissible():
            try:
                found = evaluate(problem, numbers)
            except np.linalg.LinAlgError:
                found = None
            if found is not None and found.total < now.total:
                return found, max(damping * LESS, LEAST_DAMPING)
        damping = max(damping * MORE, RESTART)
    return None, damping
