"""Levenberg–Marquardt on the whitened missing torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.arrays import Bool, Float64
from invid.refine.problem import MissingTorqueProblem

LARGEST_STEP = 0.7
"""Largest step of a logarithm in one iteration (a factor of two): unguarded steps overflow."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the fit stopped.

    ``result`` is "converged", "stalled" (no step reduces the cost, gradient not small) or "limit"
    (iterations used up). ``covariance`` is (n, n) over all parameters, zero rows where fixed, not
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
    would move by more than √tolerance standard deviations).
    """
    p = start.copy()
    free = problem.free
    dof = problem.dof
    limited = np.zeros(p.size, dtype=bool)
    limited[problem.slices["structure"]] = problem.structure.logarithmic
    limited = limited[free]
    residual, jacobian = problem.evaluate(p)
    cost = float(residual @ residual)
    damping = 1e-3
    result, used = "limit", iterations
    for iteration in range(iterations):
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0] = 1.0
        # One triangle holds all that a step needs: QR of [J, r], then the small SVD of R.
        triangle = np.asarray(np.linalg.qr(np.column_stack((jacobian / scale, residual)), mode="r"))
        count = jacobian.shape[1]
        left, size, right = np.linalg.svd(triangle[:count, :count])
        projected = left.T @ triangle[:count, count]
        keep = size > 1e-12 * size[0]
        predicted = float(projected[keep] @ projected[keep])
        if predicted < tolerance * max(cost / max(dof, 1), 1e-12):
            result, used = "converged", iteration
            break
        accepted = False
        for _ in range(12):
            step = -(right.T @ (size / (size**2 + damping) * projected)) / scale
            largest = np.abs(step[limited]).max(initial=0.0)
            if largest > LARGEST_STEP:
                step = step * (LARGEST_STEP / largest)
            trial = p.copy()
            trial[free] += step
            if problem.structure.admissible(trial[problem.slices["structure"]]):
                with np.errstate(all="ignore"):
                    try:
                        trial_residual, trial_jacobian = problem.evaluate(trial)
                        trial_cost = float(trial_residual @ trial_residual)
                    except np.linalg.LinAlgError:
                        trial_cost = np.inf
                if np.isfinite(trial_cost) and trial_cost < cost:
                    accepted = True
                    break
            damping = max(damping, 1e-8) * 8.0
        if not accepted:
            result, used = ("converged" if predicted < 0.3 * cost / max(dof, 1) else "stalled"), iteration
            break
        p, residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
        damping = max(damping / 5.0, 1e-12)
    return Solution(p, result, used, cost, dof, jacobian, residual, free)


def spectrum_of(jacobian: Float64) -> tuple[Float64, Float64, Float64, Bool]:
    """Column norms, singular values and right vectors of the scaled Jacobian, and columns that are zero."""
    scale = np.linalg.norm(jacobian, axis=0)
    blind: Bool = scale == 0
    scale = np.where(blind, 1.0, scale)
    triangle = np.asarray(np.linalg.qr(jacobian / scale, mode="r"))
    _, size, right = np.linalg.svd(triangle)
    return scale, size, right[: size.size], blind
