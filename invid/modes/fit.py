"""Modal fit of an FRF matrix: poles of a rational fit, then weighted least squares over all modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from invid.modes.data import FrfData, checked_data
from invid.modes.least_squares import ModalFit, levenberg, noise_chi2, normal_equations, reduced_chi2
from invid.modes.model import Modes, high_gain_pairs, pairs
from invid.modes.pole_search import NoisyRecord, search_modes

_GOOD = 2.0
"""χ²/dof above which modes may share poles, and by which factor it has to fall where they do (empirical)."""
_MODEL_ERROR = 0.02
"""Relative model error that the start is fitted with: friction makes the FRF wrong by more than its noise,
and then noise weights alone would spend every pole on the lowest lines."""


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
    fit = _begun(data, search_modes(_columns(data), data.masses)[0] if start is None else start)
    if data.count > 1 and noise_chi2(data, fit) > _GOOD:
        twins = _begun(data, search_modes(_columns(data), data.masses, shared=True)[0])
        left = [reduced_chi2(data, data.weight(_MODEL_ERROR), f) for f in (fit, twins)]
        fit = twins if _GOOD * left[1] < left[0] else fit
    return _finish(data, fit)


def _begun(data: FrfData, start: Modes) -> ModalFit:
    rows, columns = pairs(data.count)
    allowed = high_gain_pairs(data.masses)
    fit = ModalFit(
        start.omega.copy(),
        start.damping.copy(),
        start.shapes.copy(),
        start.high_gain[rows[allowed], columns[allowed]],
        start.friction[rows, columns],
    )
    return levenberg(data, data.weight(_MODEL_ERROR), fit, 20)


def _columns(data: FrfData) -> list[NoisyRecord]:
    """The columns of the FRF matrix as the records of one motor's torque each."""
    whole, variance = np.zeros((2, data.w.size, data.count, data.count), dtype=complex)
    rows, columns = pairs(data.count)
    for i, j in ((rows, columns), (columns, rows)):
        whole[:, i, j], variance[:, i, j] = data.g, data.variance
    return [
        NoisyRecord.of_column(data.w, whole[:, :, j], variance[:, :, j].real, j) for j in range(data.count)
    ]


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
        model_error=model_error,
        lag=np.zeros((n, count)) if fit.lag is None else fit.lag[order],
    )
