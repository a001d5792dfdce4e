"""Starts of the modal fit: poles by vector fitting from several places, residues cut to modes.

Relaxed vector fitting of fixed order, common poles of all entries of an FRF matrix: Gustavsen and Semlyen,
IEEE Trans. Power Delivery 14(3), 1999; relaxed by Gustavsen, 21(3), 2006; one QR per entry (Deschrijver et
al., 2008). Only the poles are used.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from invid.modes.data import FrfData
from invid.modes.least_squares import ModalFit
from invid.modes.model import high_gain_pairs, mode_shape_functions, pairs
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.linear_algebra import eigenvalues, least_squares, real_rows

_MOST_VALUES = 12_000  # for the pole search alone; beyond that lines add time, not poles
STARTING_DAMPING = 0.01


def pole_candidates(data: FrfData, weight: Float64, n: int) -> list[Complex128]:
    """Sets of ``n`` upper poles [rad/s] that vector fitting finds from peaks, linear and geometric starts."""
    if n == 0:
        return [np.zeros(0, dtype=complex)]
    pick = _search_lines(data, max(_MOST_VALUES // data.g.shape[1], 12 * n))
    scale = float(np.sqrt(data.w[0] * data.w[-1]))  # near 1: conditioning
    w = data.w[pick] / scale
    acceleration = -(data.w[pick, None] ** 2) * data.g[pick]
    inverse = weight[pick] / data.w[pick, None] ** 2
    found = []
    starting = _starting_frequencies(data, pick, n)
    for start in starting if n == data.modes else starting[:1]:
        poles = ((start / scale) * (-STARTING_DAMPING + 1j)).astype(np.complex128)
        found.append(relocate_poles(w, acceleration, inverse, poles, 25) * scale)
    return found


def _peakedness(data: FrfData, pick: npt.NDArray[np.intp]) -> Float64:
    """(…,) summed acceleration gain of lines, each entry relative to its own median."""
    size = np.abs(data.g[pick]) * data.w[pick, None] ** 2
    total: Float64 = np.sum((size / np.maximum(np.median(size, axis=0), np.finfo(float).tiny)) ** 2, axis=1)
    return total


def _search_lines(data: FrfData, most: int) -> npt.NDArray[np.intp]:
    """At most about ``most`` lines: half spread evenly, half where the response is largest."""
    every = np.arange(data.w.size)
    if every.size <= most:
        return every
    even = np.linspace(0, data.w.size - 1, most // 2).astype(np.intp)
    return np.union1d(even, np.argsort(_peakedness(data, every))[::-1][: most // 2])


def _starting_frequencies(data: FrfData, pick: npt.NDArray[np.intp], n: int) -> list[Float64]:
    w = data.w[pick]
    linear = np.linspace(w[0], w[-1], n + 2)[1:-1] if n > 1 else np.array([np.sqrt(w[0] * w[-1])])
    geometric = np.geomspace(w[0], w[-1], n + 2)[1:-1]
    total = _peakedness(data, pick)
    inside = np.flatnonzero((total[1:-1] > total[:-2]) & (total[1:-1] >= total[2:])) + 1
    peaks = w[inside[np.argsort(total[inside])[::-1][:n]]]
    if peaks.size < n:
        peaks = np.concatenate((peaks, linear[: n - peaks.size] * 1.01))
    return [np.sort(peaks), linear, geometric]


def residue_start(data: FrfData, weight: Float64, poles: Complex128) -> ModalFit:
    """Symmetric real residues by linear least squares for fixed poles, cut to n terms of rank one.

    A pole that several modes share has a residue of higher rank: the n strongest eigenvectors of all
    residues, by what they add to the weighted response, become the modes.
    """
    n, count = poles.size, data.count
    rows, columns = pairs(count)
    allowed = high_gain_pairs(data.masses)
    omega = np.abs(poles)
    damping = np.clip(-poles.real / np.maximum(omega, np.finfo(float).tiny), 1e-5, 0.7)
    functions = mode_shape_functions(data.w, omega, damping)
    residue = np.zeros((n, count, count))
    high, friction = np.zeros(rows.size), np.zeros(rows.size)
    for p in range(rows.size):
        columns_p = [functions, (-1j / data.w**3)[:, None]]
        if allowed[p]:
            columns_p.append((-1.0 / data.w**2 + 0j)[:, None])
        left = weight[:, p : p + 1] * np.concatenate(columns_p, axis=1)
        target = weight[:, p] * data.g[:, p]
        solution = least_squares(real_rows(left), real_rows(target), rcond=1e-10)
        residue[:, rows[p], columns[p]] = residue[:, columns[p], rows[p]] = solution[:n]
        friction[p] = solution[n]
        if allowed[p]:
            high[p] = solution[n + 1]
    strength, pole, shapes = [], [], []
    energy = np.einsum("fp,fr->rp", weight**2, np.abs(functions) ** 2)
    for r in range(n):
        values, vectors = np.linalg.eigh(residue[r])
        for value, vector in zip(values, vectors.T, strict=True):
            shape = np.sqrt(max(value, 1e-6 * max(np.abs(values).max(), 1e-30))) * vector
            strength.append(float(energy[r] @ (shape[rows] * shape[columns]) ** 2))
            pole.append(r)
            shapes.append(shape)
    strongest = np.argsort(strength)[::-1][: data.modes]
    chosen = np.array(pole, dtype=int)[strongest]
    # modes that share a pole must not start at exactly one point
    split = 1.0 + 1e-4 * np.arange(chosen.size)
    return ModalFit(
        omega[chosen] * split,
        damping[chosen],
        np.array(shapes).reshape(-1, count)[strongest],
        high[allowed],
        friction,
    )


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
