"""Coulomb friction that reverses gradually: the width of the sign that fits the records best.

Real joints reverse their friction within some mrad/s, and an axis that creeps or rests between moves spends
much of its time there: a sharp sign then puts the whole friction on the wrong side. The column of an axis
becomes tanh(v/w) with the width w of lowest cost in the linearised fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.nuisance.friction_columns import mean_sign, motor_velocity, sign_spectrum
from invid.likelihood.nuisance.torque_lags import COULOMB, LAG_FACTOR, NOISE_LIKE
from invid.likelihood.records import add_columns, used_lines
from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import stack
from invid.signals.spectra import LineSpectra

NARROWEST, WIDEST, STEPS = 1e-3, 0.3, 11
"""Widths that are tried, over the rms velocity, and their number. Physical: narrower ones are sharp for every
law, wider ones are viscous friction; neighbours differ by less than a factor of two."""


def fit_gradual_reversals(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution]:
    """Problem and solution with friction that reverses within a width of its own on each axis.

    Unchanged where the fit is at its noise, or where χ² does not fall by the factor that a lag must reach.
    """
    if solution.reduced < NOISE_LIKE:
        return problem, solution
    axes = problem.structure.axes
    places = [
        (k, axes.index(n.removesuffix(COULOMB)))
        for k, n in enumerate(problem.column_names)
        if n.endswith(COULOMB)
    ]
    larger, found = problem, solution
    for k, axis in places:
        if budget.is_left_out("how gradually friction turns over"):
            break
        best = _best_width(larger, found, spectra, k, axis)
        if best is not None:
            larger = add_columns(larger, best, larger.column_names)
            found = gauss_newton(larger, found.p)
    if larger is problem or solution.chi2 < LAG_FACTOR * found.chi2:
        return problem, solution
    return larger, found


def _best_width(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra], column: int, axis: int
) -> list[Complex128] | None:
    """Columns of all blocks with the best width of an axis' friction; ``None`` where the present one is
    best."""
    residual, jacobian = problem.evaluate(solution.p)
    place = problem.slices["column"].start + column
    if not problem.free[place]:
        return None
    at = int(np.count_nonzero(problem.free[:place]))
    others = np.delete(jacobian, at, axis=1)
    basis, _ = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))
    # The residual without this friction, with everything else refitted.
    without_friction = residual - jacobian[:, at] * solution.p[place]
    without_friction = without_friction - basis @ (basis.T @ without_friction)

    def cost_with(direction: Float64) -> float:
        own = direction - basis @ (basis.T @ direction)
        size = float(own @ own)
        gain = float(own @ without_friction) ** 2 / size if size > 0 else 0.0
        return float(without_friction @ without_friction) - gain

    states = problem.states(solution.p)
    best, least_cost = None, cost_with(jacobian[:, at])
    velocities = [motor_velocity(s)[0][:, axis] for s in spectra]
    rms = float(np.sqrt(np.mean(np.concatenate(velocities) ** 2)))
    for width in rms * np.geomspace(NARROWEST, WIDEST, STEPS):
        waves, rows = [], []
        for s, velocity, state in zip(spectra, velocities, states, strict=True):
            periodic = not s.transient or s.periods > 1
            sign = mean_sign(velocity[:, None], np.array([width]), periodic=periodic)
            wave = sign_spectrum(s, sign)[used_lines(s, everything=state.block.transient), 0]
            part = np.zeros_like(state.residual)
            part[:, axis] = wave
            white = stack(state.root @ part[..., None])[:, 0]
            rows.append(white - state.basis @ (state.basis.T @ white))
            waves.append(wave)
        rows.append(np.zeros(residual.size - sum(r.size for r in rows)))  # rows of the priors
        cost = cost_with(np.concatenate(rows))
        if cost < least_cost:
            least_cost, best = cost, waves
    if best is None:
        return None
    columns = []
    for block, wave in zip(problem.blocks, best, strict=True):
        part = block.columns.copy()
        if np.any(part[:, axis, column]):
            part[:, axis, column] = wave
        columns.append(part)
    return columns
