"""Modal fit of an FRF matrix: vector-fitted poles, then weighted least squares over all modes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from invid.errors import NotIdentifiableError
from invid.modes.data import FrfData, checked_data
from invid.modes.least_squares import (
    ModalFit,
    levenberg,
    misfit,
    noise_chi2,
    normal_equations,
    reduced_chi2,
    robust_cost,
)
from invid.modes.model import Modes, high_gain_pairs, mode_shape_functions, pairs
from invid.modes.poles import STARTING_DAMPING, pole_candidates, residue_start
from invid.numerics import budget

_GOOD = 2.0
"""χ²/dof at which the search for poles ends: no other start can do more than halve it."""
_MODEL_ERRORS = (0.0, 0.02, 0.1)
"""Relative model errors the pole search is tried with: friction makes the FRF wrong by more than its
noise, and then noise weights alone would spend every pole on the lowest lines."""


def fit_modes(
    frequency_hz: npt.ArrayLike,
    frf: npt.ArrayLike,
    frf_variance: npt.ArrayLike,
    masses: Sequence[int],
    *,
    start: Modes | None = None,
) -> Modes:
    """Modes of a measured receptance matrix, with covariance; needs no start values.

    Parameters
    ----------
    frequency_hz
        (F,) lines [Hz], > 0.
    frf
        (F, M, M) receptance Θ = G T [rad/(N·m) or m/N].
    frf_variance
        (F, M, M) or (F, M·M) variance E|n|² of each entry.
    masses
        (M,) masses per branch: fixes the number of modes Σ(N_i − 1).
    start
        Modes to start from; without, poles are searched for.

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite.
    NotIdentifiableError
        Fewer lines than unknowns.
    """
    data = checked_data(frequency_hz, frf, frf_variance, masses)
    best: tuple[float, ModalFit] | None = None
    if start is not None:
        return _finish(data, _from(data, start))
    for model_error, order in _attempts(data):
        weight = data.weight(model_error)
        for poles in pole_candidates(data, weight, order):
            if best is not None and budget.is_spent():
                break
            fit = levenberg(data, weight, residue_start(data, weight, poles), 20)
            if data.modes and noise_chi2(data, fit) > _GOOD:
                fit = levenberg(data, weight, replace(fit, lag=np.zeros(fit.shapes.shape)), 20)
            # candidates are compared under one weight that no candidate was favoured by
            cost = robust_cost(data, fit)
            if best is None or cost < best[0]:
                best = (cost, fit)
        if best is not None and noise_chi2(data, best[1]) < _GOOD:
            break
    if best is not None and data.modes and noise_chi2(data, best[1]) > _GOOD:
        best = _moved_to_the_misfit(data, best)
    if best is None:
        raise NotIdentifiableError("modal fit: no start converged; measure longer or raise the amplitude")
    return _finish(data, best[1])


def _from(data: FrfData, start: Modes) -> ModalFit:
    rows, columns = pairs(data.count)
    allowed = high_gain_pairs(data.masses)
    fit = ModalFit(
        start.omega.copy(),
        start.damping.copy(),
        start.shapes.copy(),
        start.high_gain[rows[allowed], columns[allowed]],
        start.friction[rows, columns],
    )
    return levenberg(data, data.weight(_MODEL_ERRORS[1]), fit, 20)


def _attempts(data: FrfData) -> Iterator[tuple[float, int]]:
    """Model error and number of searched poles of one attempt after another."""
    for model_error in _MODEL_ERRORS:
        yield model_error, data.modes
    # equal or symmetric branches share poles: fewer of them, with residues of higher rank
    chain = max(data.masses) - 1
    tried = {data.modes - 1, data.modes - 2, data.modes - chain, 2 * chain, chain}
    for order in sorted(tried, reverse=True):
        if 0 < order < data.modes:
            yield _MODEL_ERRORS[0], order


def _moved_to_the_misfit(data: FrfData, best: tuple[float, ModalFit]) -> tuple[float, ModalFit]:
    """Try the weakest mode where the misfit is largest: a missed peak is found there."""
    weight = data.weight(0.01)
    rows, columns = pairs(data.count)
    tried: list[float] = []
    for _ in range(4):
        if budget.is_spent():
            break
        fit = best[1]
        excess = np.sum((weight * misfit(data, fit)) ** 2, axis=1)
        excess = np.convolve(excess, np.ones(3) / 3, mode="same")
        for known in tried:
            excess[np.abs(np.log(data.w / known)) < 0.02] = 0.0
        target = float(data.w[int(np.argmax(excess))])
        tried.append(target)
        functions = mode_shape_functions(data.w, fit.omega, fit.damping)
        energy = np.einsum("fp,fr->rp", weight**2, np.abs(functions) ** 2)
        strength = np.sum(energy * (fit.shapes[:, rows] * fit.shapes[:, columns]) ** 2, axis=1)
        poles = (fit.omega * (-np.minimum(fit.damping, 0.5) + 1j)).astype(np.complex128)
        for weakest in np.argsort(strength)[:2]:
            moved = poles.copy()
            moved[weakest] = target * (-STARTING_DAMPING + 1j)
            fresh = residue_start(data, weight, moved)
            fresh = levenberg(data, weight, replace(fresh, lag=np.zeros(fresh.shapes.shape)), 30)
            cost = robust_cost(data, fresh)
            if cost < best[0]:
                best = (cost, fresh)
        if noise_chi2(data, best[1]) < _GOOD:
            break
    return best


def _with_complex_modes(data: FrfData, fit: ModalFit) -> ModalFit:
    """The fit with complex modes where the data ask for them: χ² falls by more than twice what as many
    parameters of pure noise would take."""
    if fit.omega.size == 0:
        return fit
    weight = data.weight(0.0)
    if fit.lag is None:
        start, plain = replace(fit, lag=np.zeros(fit.shapes.shape)), fit
    else:
        start, plain = fit, levenberg(data, weight, replace(fit, lag=None))
    before = reduced_chi2(data, weight, plain)
    turned = levenberg(data, data.weight(0.01), start) if before > 4.0 else start
    turned = levenberg(data, weight, turned)
    dof = 2 * data.g.size
    fall = dof * (before - reduced_chi2(data, weight, turned))
    scale = max(reduced_chi2(data, weight, turned), 1.0)
    return turned if fall > 4.0 * scale * fit.shapes.size else plain


def _finish(data: FrfData, fit: ModalFit) -> Modes:
    """Make the last iterations under the noise, or under the model error that makes χ²/dof = 1."""
    model_error = 0.0
    fit = levenberg(data, data.weight(0.0), fit) if noise_chi2(data, fit) < 4.0 else fit
    fit = _with_complex_modes(data, fit)
    if noise_chi2(data, fit) > 1.5:
        for _ in range(3):
            low, high = 1e-6, 1.0
            for _ in range(40):
                model_error = float(np.sqrt(low * high))
                if reduced_chi2(data, data.weight(model_error), fit) > 1.0:
                    low = model_error
                else:
                    high = model_error
            fit = levenberg(data, data.weight(model_error), fit)
    allowed = high_gain_pairs(data.masses)
    _, _, hessian = normal_equations(data, data.weight(model_error), fit, allowed)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    # a complex variance E|n|² puts half into each part, hence 2 × the information
    covariance = (
        0.5 * np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    )
    order = np.argsort(fit.omega)
    n, count = fit.shapes.shape
    tail = 2 * n + n * count + fit.high.size + fit.friction.size
    index = np.concatenate(
        (
            order,
            n + order,
            (2 * n + order[:, None] * count + np.arange(count)).ravel(),
            np.arange(2 * n + n * count, tail),
            [] if fit.lag is None else (tail + order[:, None] * count + np.arange(count)).ravel(),
        )
    ).astype(int)
    rows, columns = pairs(count)
    high_gain, friction = np.zeros((count, count)), np.zeros((count, count))
    high_gain[rows[allowed], columns[allowed]] = high_gain[columns[allowed], rows[allowed]] = fit.high
    friction[rows, columns] = friction[columns, rows] = fit.friction
    return Modes(
        omega=fit.omega[order],
        damping=fit.damping[order],
        shapes=fit.shapes[order],
        high_gain=high_gain,
        friction=friction,
        masses=data.masses,
        covariance=covariance[np.ix_(index, index)],
        chi2=float(2 * np.sum((data.weight(0.0) * misfit(data, fit)) ** 2)),
        dof=2 * data.g.size - covariance.shape[0],
        model_error=model_error,
        lag=np.zeros((n, count)) if fit.lag is None else fit.lag[order],
    )
