"""Levenberg–Marquardt on the whitened missing torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64

LARGEST_STEP = 0.7
"""Largest step of a logarithm in one iteration (a factor of two): unguarded steps overflow."""


NEARLY = 0.3
"""Predicted decrease of χ², in units of χ²/ν, below which a search that can go no further has arrived:
half a standard deviation of one combination of parameters."""


@dataclass(frozen=True, eq=False)
class _Point:
    """Where the search stands."""

    p: Float64
    residual: Float64
    jacobian: Float64
    cost: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the fit stopped.

    ``result`` is "converged", "stalled" (no step reduces the cost, gradient not small) or "limit"
    (iterations or time used up). ``covariance`` is (n, n) over all parameters, zero rows where fixed, not
    inflated. ``chi2`` is the whitened sum of squares with ``dof`` real degrees of freedom.
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
    """Minimise the cost from ``start``.

    Converged when the predicted decrease of χ² is below ``tolerance`` times χ²/ν (then no parameter
    would move by more than √tolerance standard deviations); where the iterations end in a valley that
    bends, a step of half a standard deviation still counts.
    """
    p = start.copy()
    free, structure = problem.free, problem.structure
    dof = problem.dof
    limited = np.zeros(p.size, dtype=bool)
    limited[problem.slices["structure"]] = problem.structure.logarithmic
    limited = limited[free]

    def at(step: Float64) -> _Point | None:
        whole = np.zeros(p.size)
        whole[free] = step
        trial = p + whole
        trial[: structure.count] = structure.moved(p[: structure.count], whole[: structure.count])
        trial[~free] = p[~free]
        if not structure.admissible(trial[: structure.count]):
            return None
        with np.errstate(all="ignore"):
            try:
                residual, jacobian = problem.evaluate(trial)
            except np.linalg.LinAlgError:
                return None
        cost = float(residual @ residual)
        return _Point(trial, residual, jacobian, cost) if np.isfinite(cost) else None

    residual, jacobian = problem.evaluate(p)
    now = _Point(p, residual, jacobian, float(residual @ residual))
    damping = 1e-3
    result, used, predicted = "limit", iterations, np.inf
    for iteration in range(iterations):
        if budget.is_left_out("fits to their end"):
            used = iteration
            break
        scale = np.linalg.norm(now.jacobian, axis=0)
        scale[scale == 0] = 1.0
        # Normal equations: a step needs no more digits than they keep, and a product is several times
        # faster than the QR of as many rows. Covariances come from a QR (``spectrum_of``).
        scaled = now.jacobian / scale
        size, vectors = np.linalg.eigh(scaled.T @ scaled)
        size = np.maximum(size, 1e-14 * max(size[-1], 1e-300))
        gradient = scaled.T @ now.residual
        projected = vectors.T @ gradient
        predicted = float(projected @ (projected / size))
        unit = max(now.cost / max(dof, 1), 1e-12)
        if predicted < tolerance * unit:
            result, used = "converged", iteration
            break
        following: _Point | None = None
        for _ in range(12):
            step = -(vectors @ (projected / (size + damping))) / scale
            largest = np.abs(step[limited]).max(initial=0.0)
            if largest > LARGEST_STEP:
                step = step * (LARGEST_STEP / largest)
            slope = 2.0 * float((gradient * scale) @ step)
            following = at(step)
            if following is not None:
                following = _shortened(now, following, slope, step, at)
                if following.cost < now.cost:
                    break
            following = None
            damping = max(damping, 1e-9) * 8.0
        if following is None:
            result, used = ("converged" if predicted < NEARLY * unit else "stalled"), iteration
            break
        now, p = following, following.p
        damping = max(damping / 8.0, 1e-15)
    if result == "limit" and predicted < NEARLY * max(now.cost / max(dof, 1), 1e-12):
        result = "converged"
    return Solution(now.p, result, used, now.cost, dof, now.jacobian, now.residual, free)


def _shortened(
    now: _Point, full: _Point, slope: float, step: Float64, at: Callable[[Float64], _Point | None]
) -> _Point:
    """The better of a full step and the minimum of the parabola through it, where that is much shorter."""
    if full.cost <= now.cost + 0.25 * slope:
        return full
    curvature = full.cost - now.cost - slope
    share = -slope / (2.0 * curvature) if curvature > 0 else 1.0
    if not 0.02 < share < 0.8:
        return full
    shorter = at(share * step)
    return shorter if shorter is not None and shorter.cost < full.cost else full


def spectrum_of(jacobian: Float64) -> tuple[Float64, Float64, Float64, Bool]:
    """Column norms, singular values and right vectors of the scaled Jacobian, and columns that are zero."""
    scale = np.linalg.norm(jacobian, axis=0)
    blind: Bool = scale == 0
    scale = np.where(blind, 1.0, scale)
    triangle = np.asarray(np.linalg.qr(jacobian / scale, mode="r"))
    _, size, right = np.linalg.svd(triangle)
    return scale, size, right[: size.size], blind
