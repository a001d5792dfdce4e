"""Weighted least squares of the modal model: response, normal equations, Levenberg–Marquardt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.modes.data import FrfData
from invid.modes.model import high_gain_pairs, lag_functions, mode_shape_functions, pairs
from invid.numerics import budget
from invid.numerics.arrays import Bool, Complex128, Float64

LARGEST_STEP = 0.7
"""Largest step of a logarithm in one iteration (a factor of two): unguarded steps overflow."""
FIRST, LEAST, FROM, LESS, MORE, TRIALS = 1e-3, 1e-12, 1e-6, 1.0 / 8.0, 10.0, 8
"""Damping of parameters scaled to unit columns: at the start, its least, where it begins again after a step
that did not go down, its factors, and how many are tried."""
GAIN = 1e-6
"""Share of the cost that an iteration has to take for another to follow (numerical)."""


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Parameters of the modal model (see ``Modes``), in any order of modes."""

    omega: Float64
    damping: Float64
    shapes: Float64  # (n, M)
    high: Float64  # (allowed,)
    friction: Float64  # (P,)
    lag: Float64 | None = None  # (n, M) where complex modes are fitted


def model_response(data: FrfData, fit: ModalFit, allowed: Bool) -> Complex128:
    """(F, P) receptance of the modal model; ``allowed`` (P,) tells where A_H has entries."""
    rows, columns = pairs(data.count)
    g = mode_shape_functions(data.w, fit.omega, fit.damping) @ (fit.shapes[:, rows] * fit.shapes[:, columns])
    g = g - 1j * fit.friction / data.w[:, None] ** 3
    g[:, allowed] -= fit.high / data.w[:, None] ** 2
    if fit.lag is not None:
        turned = fit.shapes[:, rows] * fit.lag[:, columns] + fit.lag[:, rows] * fit.shapes[:, columns]
        g = g + lag_functions(data.w, fit.omega, fit.damping) @ turned
    out: Complex128 = g
    return out


def _pack(fit: ModalFit) -> Float64:
    lag = np.zeros(0) if fit.lag is None else fit.lag.ravel()
    packed: Float64 = np.concatenate(
        (np.log(fit.omega), np.log(fit.damping), fit.shapes.ravel(), fit.high, fit.friction, lag)
    )
    return packed


def _unpack(x: Float64, like: ModalFit) -> ModalFit:
    n, count = like.shapes.shape
    a, b = 2 * n, 2 * n + n * count
    c = b + like.high.size
    d = c + like.friction.size
    lag = None if like.lag is None else x[d:].reshape(n, count)
    return ModalFit(np.exp(x[:n]), np.exp(x[n:a]), x[a:b].reshape(n, count), x[b:c], x[c:d], lag)


def normal_equations(
    data: FrfData, weight: Float64, fit: ModalFit, allowed: Bool
) -> tuple[float, Float64, Float64]:
    """Cost, gradient and Gauss–Newton matrix, entry by entry so that memory stays small."""
    n, count = fit.shapes.shape
    rows, columns = pairs(count)
    w = data.w
    functions = mode_shape_functions(w, fit.omega, fit.damping)
    receptance = functions - 1.0 / w[:, None] ** 2
    squared = receptance**2
    by_omega = -squared * (2 * fit.omega**2 + 2j * fit.damping * fit.omega * w[:, None])
    by_damping = -squared * (2j * fit.damping * fit.omega * w[:, None])
    residual = weight * (model_response(data, fit, allowed) - data.g)
    after_shapes = 2 * n + n * count
    after_high = after_shapes + int(allowed.sum())
    after_friction = after_high + rows.size
    size = after_friction + (0 if fit.lag is None else n * count)
    quarter = lag_functions(w, fit.omega, fit.damping)
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    place = np.cumsum(allowed) - 1
    for p, (i, j) in enumerate(zip(rows, columns, strict=True)):
        product = fit.shapes[:, i] * fit.shapes[:, j]
        blocks = [by_omega * product, by_damping * product, functions * fit.shapes[:, j]]
        index = [np.arange(2 * n), 2 * n + np.arange(n) * count + i]
        if i == j:
            blocks[-1] = 2 * blocks[-1]
        else:
            blocks.append(functions * fit.shapes[:, i])
            index.append(2 * n + np.arange(n) * count + j)
        if allowed[p]:
            blocks.append(-1.0 / w[:, None] ** 2 + 0j)
            index.append(np.array([after_shapes + place[p]]))
        blocks.append(-1j / w[:, None] ** 3)
        index.append(np.array([after_high + p]))
        if fit.lag is not None:
            # d/dφ and d/dχ of φ_iχ_j + χ_iφ_j; its dependence on ω_r and ζ_r is of second order
            blocks[2] = blocks[2] + quarter * fit.lag[:, j] * (2 if i == j else 1)
            blocks.append(quarter * fit.shapes[:, j] * (2 if i == j else 1))
            index.append(after_friction + np.arange(n) * count + i)
            if i != j:
                blocks[3] = blocks[3] + quarter * fit.lag[:, i]
                blocks.append(quarter * fit.shapes[:, i])
                index.append(after_friction + np.arange(n) * count + j)
        jacobian = weight[:, p : p + 1] * np.concatenate(blocks, axis=1)
        at = np.concatenate(index)
        gradient[at] += (jacobian.conj().T @ residual[:, p]).real
        hessian[np.ix_(at, at)] += (jacobian.conj().T @ jacobian).real
    if fit.lag is not None:
        prior = _lag_prior(fit)
        at = after_friction + np.arange(n * count)
        gradient[at] += prior * fit.lag.ravel()
        hessian[at, at] += prior
    return _cost(data, weight, fit, allowed), gradient, hessian


def _lag_prior(fit: ModalFit) -> Float64:
    """Inverse variance of χ before any data: half the size of its mode's shape. Dampers that turn a
    mode further than that make it no mode; only what no motor sees is decided by it."""
    size = np.sqrt(np.mean(fit.shapes**2, axis=1))
    prior: Float64 = np.repeat(1.0 / (0.5 * np.maximum(size, 1e-12)) ** 2, fit.shapes.shape[1])
    return prior


def _cost(data: FrfData, weight: Float64, fit: ModalFit, allowed: Bool) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(np.sum(np.abs(weight * (model_response(data, fit, allowed) - data.g)) ** 2))
    if fit.lag is not None:
        cost += float(np.sum(_lag_prior(fit) * fit.lag.ravel() ** 2))
    return cost


def levenberg(data: FrfData, weight: Float64, start: ModalFit, iterations: int = 60) -> ModalFit:
    """Levenberg–Marquardt from ``start`` under ``weight`` (F, P); resonances and damping in logarithms."""
    allowed = high_gain_pairs(data.masses)
    n, x, damping = start.omega.size, _pack(start), FIRST
    cost = _cost(data, weight, start, allowed)
    for _ in range(iterations):
        if budget.is_left_out("fits to their end"):
            break
        _, gradient, normal = normal_equations(data, weight, _unpack(x, start), allowed)
        unit = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        curvature, axes = np.linalg.eigh(normal / unit[:, None] / unit)
        curvature = np.maximum(curvature, 1e-14 * curvature[-1])
        before = cost
        for _ in range(TRIALS):
            step = -(axes @ (axes.T @ (gradient / unit) / (curvature + damping))) / unit
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step[: 2 * n]).max(initial=0.0)), 1e-300))
            trial = x + step
            trial[n : 2 * n] = np.clip(trial[n : 2 * n], *np.log((1e-7, 2.0)))
            tried = _cost(data, weight, _unpack(trial, start), allowed)
            if tried < cost:
                x, cost, damping = trial, tried, max(damping * LESS, LEAST)
                break
            damping = max(damping, FROM) * MORE
        if before - cost <= GAIN * before:
            break
    return _unpack(x, start)


def misfit(data: FrfData, fit: ModalFit) -> Float64:
    """(F, P) magnitude of what the fit leaves."""
    difference: Float64 = np.abs(model_response(data, fit, high_gain_pairs(data.masses)) - data.g)
    return difference


def reduced_chi2(data: FrfData, weight: Float64, fit: ModalFit) -> float:
    """χ² per degree of freedom under ``weight`` (a complex variance puts half into each part)."""
    dof = max(2 * data.g.size - _pack(fit).size, 1)
    return float(2 * np.sum((weight * misfit(data, fit)) ** 2) / dof)


def noise_chi2(data: FrfData, fit: ModalFit) -> float:
    """Return χ² per degree of freedom under the FRF's noise alone."""
    return reduced_chi2(data, data.weight(0.0), fit)
