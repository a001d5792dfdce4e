"""The fit of an identification: Levenberg–Marquardt on the whitened missing torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.likelihood.residual import MissingTorqueProblem, State
from invid.numerics.arrays import Bool, Float64
from invid.numerics.levenberg_marquardt import NEARLY, Parabola, minimise


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the search with residual and cost; its Jacobian is computed on demand."""

    problem: MissingTorqueProblem
    p: Float64
    states: Sequence[State]
    residual: Float64
    cost: float

    @cached_property
    def jacobian(self) -> Float64:
        """(rows, free parameters)."""
        return self.problem.jacobian_of(self.states)


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a fit.

    ``result`` is "converged", "stalled" (no step reduces the cost, gradient not small) or "limit" (iterations
    or time used up). ``covariance`` is (n, n) over all parameters, zero rows where fixed, not inflated.
    ``chi2`` is the whitened sum of squares with ``dof`` real degrees of freedom.
    """

    p: Float64
    result: str
    iterations: int
    chi2: float
    dof: int
    jacobian: Float64
    residual: Float64
    free: Bool

    @property
    def reduced(self) -> float:
        """χ²/ν."""
        return self.chi2 / max(self.dof, 1)


def gauss_newton(
    problem: MissingTorqueProblem,
    start: Float64,
    *,
    iterations: int = 60,
    tolerance: float = 1e-3,
) -> Solution:
    """The solution from ``start`` (n,).

    Converged when the predicted decrease of χ² is below ``tolerance`` times χ²/ν (then no parameter would
    move by more than √tolerance standard deviations); where the iterations end in a curved valley, a step of
    half a standard deviation counts as converged.
    """
    free, structure = problem.free, problem.structure
    limited = np.zeros(start.size, dtype=bool)
    limited[problem.slices["structure"]] = structure.logarithmic

    def point_at(p: Float64, limit: float = np.inf) -> _Point | None:
        states, least = list[State](), 0.0
        for state in problem.each_state(p):
            states.append(state)
            least += float(state.white @ state.white)
            if least > limit:
                return None
        residual = problem.residual_of(p, states)
        return _Point(problem, p, states, residual, float(residual @ residual))

    def take_step(here: _Point, step: Float64, limit: float) -> _Point | None:
        whole = np.zeros(start.size)
        whole[free] = step
        trial = here.p + whole
        part = slice(structure.count)
        trial[part] = structure.moved(here.p[part], whole[part])
        trial[~free] = here.p[~free]
        if not structure.admissible(trial[part]):
            return None
        with np.errstate(all="ignore"):
            try:
                return point_at(trial, limit)
            except np.linalg.LinAlgError:
                return None

    begun = point_at(start.copy())
    assert begun is not None  # noqa: S101 - without a limit
    found = minimise(
        begun,
        lambda here: Parabola.of_rows(here.jacobian, here.residual),
        take_step,
        limited=limited[free],
        iterations=iterations,
        dof=problem.dof,
        tolerance=tolerance,
    )
    last, result = found.point, found.result
    if result == "limit" and found.predicted < NEARLY * max(last.cost / max(problem.dof, 1), 1e-12):
        result = "converged"
    return Solution(
        last.p, result, found.iterations, last.cost, problem.dof, last.jacobian, last.residual, free
    )


def jacobian_spectrum(jacobian: Float64) -> tuple[Float64, Float64, Float64, Bool]:
    """Column norms, singular values and right vectors of the scaled Jacobian, and columns that are zero."""
    scale = np.linalg.norm(jacobian, axis=0)
    blind: Bool = scale == 0
    scale = np.where(blind, 1.0, scale)
    triangle = np.asarray(np.linalg.qr(jacobian / scale, mode="r"))
    _, size, right = np.linalg.svd(triangle)
    return scale, size, right[: size.size], blind
