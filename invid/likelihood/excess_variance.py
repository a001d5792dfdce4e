"""The residual beyond the sensors' noise as a variance of its own.

Friction that sticks, ripple, anything that the model lacks shows as missing torque larger than the noise
predicts. Rows (one axis in one record) with it get less weight, and the covariance of the parameters becomes
realistic.
"""

from __future__ import annotations

import numpy as np

from invid.likelihood.levenberg_marquardt import Solution, jacobian_spectrum
from invid.likelihood.residual import MissingTorqueProblem, State
from invid.numerics.arrays import Float64

WINDOW = 24
"""Neighbouring lines that share one excess variance (statistical: its standard error is then 20 %)."""
SIGNIFICANT = 3.0
"""Standard errors from which an excess counts (statistical)."""


def excess_variance(
    problem: MissingTorqueProblem, solution: Solution, base: list[Float64]
) -> tuple[list[Float64], list[Float64]]:
    """Noise powers with the excess added to the torque of each axis, and the excess (F, M) per block.

    ``base`` is each block's sensor noise (F, 2M).
    """
    plain = problem.with_noise(base)
    states = problem.states(solution.p)
    base_states = plain.states(solution.p)
    leverage = _leverage(problem, solution)
    powers, excesses = [], []
    for state, base_state, lev, noise in zip(states, base_states, leverage, base, strict=True):
        excess = _smooth_excess(state, base_state, lev)
        power = noise.copy()
        power[:, excess.shape[1] :] += excess
        powers.append(power)
        excesses.append(excess)
    return powers, excesses


def _leverage(problem: MissingTorqueProblem, solution: Solution) -> list[Float64]:
    """Per block (M,) the mean share of a row's variance that the fit has absorbed."""
    scale, size, right, _ = jacobian_spectrum(solution.jacobian)
    seen = size > 1e-10 * size[0]
    hat = ((solution.jacobian @ (right[seen] / size[seen, None] / scale).T) ** 2).sum(axis=1)
    out, at = [], 0
    for block in problem.blocks:
        lines, motors = block.position.shape
        own = hat[at : at + 2 * lines * motors].reshape(2, lines, motors).sum(axis=(0, 1)) / (2 * lines)
        if block.transient:
            own = own + 2 * problem.structure.dofs / (2 * lines * motors)
        out.append(np.minimum(own, 0.8))
        at += 2 * lines * motors
    return out


def _smooth_excess(state: State, base: State, leverage: Float64) -> Float64:
    """(F, M) excess torque power, smooth over the lines."""
    power = np.abs(state.residual) ** 2 / (1.0 - leverage)
    floor = np.einsum("fii->fi", base.covariance).real
    lines, motors = power.shape
    out = np.zeros((lines, motors))
    for i in range(motors):
        overall, error = _common_excess(power[:, i], floor[:, i])
        start = overall if overall > SIGNIFICANT * error else 0.0
        out[:, i] = start
        if lines < 2 * WINDOW:
            continue
        for low in range(0, lines, WINDOW // 2):
            part = slice(max(low - WINDOW // 4, 0), min(low + 3 * WINDOW // 4, lines))
            value, error = _common_excess(power[part, i], floor[part, i])
            target = slice(low, min(low + WINDOW // 2, lines))
            out[target, i] = value if value > SIGNIFICANT * error else 0.0
    return out


def _common_excess(power: Float64, floor: Float64) -> tuple[float, float]:
    """One excess x ≥ 0 with E[power] = floor + x and its standard error, by iterated weighted means."""
    x = 0.0
    error = np.inf
    for _ in range(30):
        weight = 1.0 / (floor + x) ** 2
        new = max(float((weight * (power - floor)).sum() / weight.sum()), 0.0)
        error = float(1.0 / np.sqrt(weight.sum()))
        if abs(new - x) <= 1e-3 * max(new, 1e-300):
            x = new
            break
        x = 0.5 * (x + new)
    return x, error
