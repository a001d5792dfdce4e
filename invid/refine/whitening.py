"""Rows of unit variance from complex lines with a noise covariance, and back."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128, Float64


def whitener(covariance: Complex128) -> Complex128:
    """√2·L⁻¹ of (F, M, M): real and imaginary part of the whitened residual have unit variance."""
    diagonal = np.sqrt(np.maximum(np.einsum("fii->fi", covariance).real, 1e-300))
    scaled = covariance / diagonal[:, :, None] / diagonal[:, None, :]
    # 1e-12 of a unit diagonal: quantised channels that repeat exactly must not stop the fit
    lower = np.linalg.cholesky(scaled + 1e-12 * np.eye(covariance.shape[1]))
    root: Complex128 = np.sqrt(2.0) * np.linalg.inv(lower) / diagonal[:, None, :]
    return root


def unwhitener(root: Complex128) -> Complex128:
    """(F, M, M) inverse of a whitener, identity on lines that it switches off."""
    off = np.abs(root).sum(axis=(1, 2)) == 0
    out = root.copy()
    out[off] = np.eye(root.shape[1])
    inverse: Complex128 = np.asarray(np.linalg.inv(out), dtype=np.complex128)
    return inverse


def stack(values: Complex128) -> Float64:
    """(F, M, n) complex to (2FM, n) real rows."""
    flat = values.reshape(-1, values.shape[-1])
    return np.concatenate((flat.real, flat.imag))


def unstack(back: Complex128, rows: Float64, shape: tuple[int, ...]) -> Complex128:
    """(2FM,) whitened rows to (F, M) = ``shape`` complex, through the unwhitener ``back``."""
    half = rows.size // 2
    white = (rows[:half] + 1j * rows[half:]).reshape(shape)
    out: Complex128 = (back @ white[..., None])[..., 0]
    return out


def orthonormal(columns: Float64) -> Float64:
    """(rows, rank) basis of what the columns span."""
    scale = np.linalg.norm(columns, axis=0)
    left, size, _ = np.linalg.svd(columns[:, scale > 0] / scale[scale > 0], full_matrices=False)
    out: Float64 = left[:, size > 1e-9 * size[0]]
    return out


__all__ = ["orthonormal", "stack", "unstack", "unwhitener", "whitener"]
