"""Relaxed vector fitting of fixed order: common poles of all entries of an FRF matrix.

Gustavsen and Semlyen, IEEE Trans. Power Delivery 14(3), 1999; relaxed by Gustavsen, 21(3), 2006; one QR
per entry (Deschrijver et al., 2008). Only the poles are used: they start the modal fit.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.linear_algebra import eigenvalues, least_squares, real_rows


def relocate_poles(
    w: Float64, response: Complex128, weight: Float64, poles: Complex128, iterations: int
) -> Complex128:
    """(n,) upper poles of n complex pairs after ``iterations`` relocations.

    Parameters
    ----------
    w, response, weight
        (F,) rad/s, (F, P) data (acceleration FRFs, proper), (F, P) inverse standard deviations.
    poles
        (n,) starting poles, imaginary parts > 0, in the units of ``w``.
    """
    for _ in range(iterations):
        fresh = _relocate(w, response, weight, poles)
        if fresh is None:
            return poles
        if np.allclose(fresh, poles, rtol=1e-9, atol=0):
            return fresh
        poles = fresh
    return poles


def _basis(w: Float64, poles: Complex128) -> Complex128:
    s = 1j * w[:, None]
    up, down = 1.0 / (s - poles), 1.0 / (s - poles.conj())
    basis = np.empty((w.size, 2 * poles.size), dtype=complex)
    basis[:, 0::2], basis[:, 1::2] = up + down, 1j * (up - down)
    return basis


def _relocate(w: Float64, response: Complex128, weight: Float64, poles: Complex128) -> Complex128 | None:
    """The zeros of σ as poles; ``None`` where the data leave no finite ones."""
    basis = _basis(w, poles)
    order, entries = basis.shape[1], response.shape[1]
    common: Complex128 = np.column_stack((basis, np.ones(w.size), 1.0 / (1j * w)))  # gain, and friction's 1/s
    sigma = np.column_stack((basis, np.ones(w.size)))
    rows, right = [], []
    for p in range(entries):
        if not np.any(weight[:, p] > 0):
            continue
        left = real_rows(weight[:, p : p + 1] * common)
        scale = np.linalg.norm(left, axis=0)
        left /= np.where(scale > 0, scale, 1.0)
        denominator = real_rows(-(weight[:, p] * response[:, p])[:, None] * sigma)
        if not (np.isfinite(left).all() and np.isfinite(denominator).all()):
            return None
        factor = scipy.linalg.qr(np.column_stack((left, denominator)), mode="r")[0]
        rows.append(factor[common.shape[1] :, common.shape[1] :])
        right.append(np.zeros(rows[-1].shape[0]))
    # relaxation: Σ Re σ(jω) = F, weighted as the data are
    emphasis = np.sqrt(np.sum(np.abs(weight * response) ** 2)) / w.size
    rows.append(emphasis * np.sum(sigma.real, axis=0, keepdims=True))
    right.append(np.array([emphasis * w.size]))
    matrix, target = np.concatenate(rows), np.concatenate(right)
    if not np.isfinite(np.linalg.norm(matrix, axis=0)).all():
        return None
    solution = least_squares(matrix, target)
    residues, direct = solution[:order], solution[order]
    if abs(direct) < 1e-8:
        direct = np.copysign(1e-8, direct)
    state = np.zeros((order, order))
    even = np.arange(0, order, 2)
    state[even, even] = state[even + 1, even + 1] = poles.real
    state[even, even + 1], state[even + 1, even] = poles.imag, -poles.imag
    drive = np.zeros(order)
    drive[even] = 2.0
    values = eigenvalues(state - np.outer(drive, residues) / direct)
    return None if values is None else _pairs(values, poles, w)


def _pairs(values: Complex128, before: Complex128, w: Float64) -> Complex128:
    """As many stable complex pairs as before: unstable ones mirrored, real ones joined in twos."""
    values = -np.abs(values.real) + 1j * values.imag
    upper = values[values.imag > 0]
    real = np.sort(values[values.imag == 0].real)
    if upper.size < before.size:
        # two real poles describe no mode: put a lightly damped pair at their geometric mean
        for k in range(before.size - upper.size):
            twin = real[2 * k : 2 * k + 2] if real.size >= 2 * k + 2 else np.array([-w[0], -w[-1]])
            centre = float(np.clip(np.sqrt(np.prod(twin)), w[0], 2.0 * w[-1]))
            upper = np.append(upper, (-0.05 + 1j) * centre)
    ordered: Complex128 = upper[np.argsort(upper.imag)][: before.size]
    return ordered
