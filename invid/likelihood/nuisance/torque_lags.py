"""Parameters of torque channels: Coulomb friction beside the torque, late reversals, low-pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.nuisance.friction_columns import coulomb_columns
from invid.likelihood.records import add_columns, transfer_parameters, used_lines
from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectra import LineSpectra

COULOMB = ".coulomb"
HOLD_LAG = ".hold_lag"
"""Endings of the names of columns: Coulomb friction, and a hold inside the drive acting later."""
COULOMB_SIGMA = 4.0
"""Standard deviations (excess variance included) below which Coulomb friction leaves the fit
(statistical)."""
REVERSAL = ".reversal_lag"
"""Ending of the names of the columns for friction that reverses later than the velocity."""

TORQUE_LAG = ".torque_lag"
"""Ending of the names of the squares of torque channels' time constants [s²]."""
LAG_SIGNIFICANCE = 1e-3
"""Significance at which a torque channel is taken to be low-passed (statistical)."""
NOISE_LIKE = 1.5
"""χ²/ν below which a fit is at the noise, as for a start (``fit._fit_best_start``)."""
LAG_FACTOR = 1.3
"""Factor by which χ² must fall where the lag does not bring it to the noise, as for a further mass
(empirical: unmodelled friction makes any further parameter a little better)."""


def add_coulomb_columns(
    problem: MissingTorqueProblem, spectra: Sequence[LineSpectra]
) -> MissingTorqueProblem:
    """One Coulomb coefficient for each axis that moves clearly in some record, and one lag for each hold
    that works beside a command inside the drive."""
    motors = problem.structure.motors
    found = [coulomb_columns(s) for s in spectra]
    axes = [i for i in range(motors) if any(bool(moves[i]) for _, moves in found)]
    held = [
        i
        for i in range(motors)
        if any(s.hold_torque is not None and bool(np.any(s.hold_torque[:, i])) for s in spectra)
    ]
    columns = []
    for (spectrum, moves), s, block in zip(found, spectra, problem.blocks, strict=True):
        used = used_lines(s, everything=block.transient)
        part = np.zeros((int(used.sum()), motors, len(axes) + len(held)), dtype=complex)
        for at, i in enumerate(axes):
            if moves[i]:
                part[:, i, at] = spectrum[used, i]
        for at, i in enumerate(held, start=len(axes)):
            if s.hold_torque is not None:
                part[:, i, at] = 1j * s.omega[used] * s.hold_torque[used, i]
        columns.append(part)
    names = problem.structure.axes
    lags = [f"{names[i]}{HOLD_LAG}" for i in held]
    step = max(b.step for b in problem.blocks)
    # A drive's own loop runs several times a sample; its torque acts within one such cycle.
    known = dict.fromkeys(lags, (0.0, step / 8.0))
    problem = replace(problem, priors={**problem.priors, **known})
    return add_columns(problem, columns, [f"{names[i]}{COULOMB}" for i in axes] + lags)


def fit_reversal_lags(
    problem: MissingTorqueProblem, solution: Solution
) -> tuple[MissingTorqueProblem, Solution]:
    """The problem with ``reversal_lags`` for the friction found, and its solution."""
    larger = reversal_lags(problem, solution.p)
    if larger is problem:
        return problem, solution
    return larger, gauss_newton(larger, transfer_parameters(problem, solution.p, larger))


def reversal_lags(problem: MissingTorqueProblem, p: Float64) -> MissingTorqueProblem:
    """The problem with a lag of each Coulomb friction's reversal, known to half a sample.

    A motor that reverses stands for a moment, and the sign of its velocity does not tell when its friction
    reversed. Friction that reverses later looks like motor inertia: with the instant taken as known, the
    motor's mass was off by three to five of its standard deviations (virtual cells). ``p`` (n,) holds the
    size of the friction.
    """
    names = problem.column_names
    size = np.abs(p[problem.slices["column"]])
    has_friction = [k for k, n in enumerate(names) if n.endswith(COULOMB) and size[k] > 0]
    if not has_friction:
        return problem
    columns = []
    for block in problem.blocks:
        delayed = -1j * block.omega[:, None, None] * block.columns[:, :, has_friction]
        columns.append(np.concatenate((block.columns, delayed), axis=2))
    lags = tuple(names[k].removesuffix(COULOMB) + REVERSAL for k in has_friction)
    step = max(b.step for b in problem.blocks)
    # Uniform within half a sample either way: a standard deviation of h/√12.
    known = {n: (0.0, float(size[k]) * step / np.sqrt(12.0)) for n, k in zip(lags, has_friction, strict=True)}
    return replace(add_columns(problem, columns, names + lags), priors={**problem.priors, **known})


def fit_torque_lags(
    problem: MissingTorqueProblem, solution: Solution
) -> tuple[MissingTorqueProblem, Solution]:
    """Problem and solution with a first-order lag in each axis' torque channel, where it is significant.

    A drive that smooths the torque it reports delays it, which the time offset absorbs, and reduces it by
    ω²τ²/2, which nothing else does: masses and springs were off by 0.25 %, ten of their standard deviations,
    with 2 ms at 13 Hz.
    """
    axes, motors = problem.structure.axes, problem.structure.motors
    first = len(problem.delay_names)
    blocks = tuple(replace(b, lag_index=tuple(range(first, first + motors))) for b in problem.blocks)
    names = (*problem.delay_names, *(f"{a}{TORQUE_LAG}" for a in axes))
    larger = replace(problem, blocks=blocks, delay_names=names)
    found = gauss_newton(larger, transfer_parameters(problem, solution.p, larger))
    scale = max(found.reduced, 1.0)
    if solution.chi2 - found.chi2 < scale * chi2_isf(LAG_SIGNIFICANCE, motors):
        return problem, solution
    if found.reduced > NOISE_LIKE and solution.chi2 < LAG_FACTOR * found.chi2:
        return problem, solution
    return larger, found
