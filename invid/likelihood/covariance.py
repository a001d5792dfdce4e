"""Covariance and standard deviations of a solution, inflated by χ²/ν."""

from __future__ import annotations

import numpy as np

from invid.likelihood.levenberg_marquardt import Solution, jacobian_spectrum
from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics.arrays import Float64, Int64


def physical_covariance(problem: MissingTorqueProblem, solution: Solution) -> Float64:
    """(n, n) covariance of the structure's parameters in physical units, inflated where χ²/ν > 1.

    Variances of parameters that the data do not determine are infinite.
    """
    full = np.zeros((solution.p.size, solution.p.size))
    free = np.flatnonzero(solution.free)
    inverse, lost = inverse_normal(solution.jacobian)
    inverse[lost, lost] = np.inf
    full[np.ix_(free, free)] = inverse * max(1.0, solution.reduced)
    count = problem.structure.count
    values = problem.structure.physical(solution.p[:count])
    factor = np.where(problem.structure.logarithmic, values, 1.0)
    with np.errstate(invalid="ignore"):
        result: Float64 = full[:count, :count] * factor[:, None] * factor
    return result


def inverse_normal(jacobian: Float64) -> tuple[Float64, Int64]:
    """(n, n) inverse of JᵀJ, and the numbers of the parameters that the data do not determine.

    Directions with singular values below 1e-9 of the largest (columns scaled) are left out of the inverse;
    every parameter that they change by more than a hundredth counts as not determined.
    """
    scale, size, right, blind = jacobian_spectrum(jacobian)
    seen = size > 1e-9 * size[0]
    inverse: Float64 = (right[seen].T / size[seen] ** 2) @ right[seen] / scale[:, None] / scale
    return inverse, np.flatnonzero(blind | (np.abs(right[~seen]) > 1e-2).any(axis=0))


def parameter_std(solution: Solution) -> Float64:
    """(n,) inflated standard deviation of every parameter as it is fitted (logarithms relative).

    NaN where fixed, infinite where the data do not determine it.
    """
    scale, size, right, blind = jacobian_spectrum(solution.jacobian)
    size = np.maximum(size, 1e-9 * size[0])
    own = np.sqrt(((right / size[:, None]) ** 2).sum(axis=0)) / scale
    own[blind] = np.inf
    out = np.full(solution.p.size, np.nan)
    out[solution.free] = own * np.sqrt(max(1.0, solution.reduced))
    return out
