"""Rows of unit variance from complex lines with a noise covariance."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64


def whitener(covariance: Complex128) -> Complex128:
    """√2·L⁻¹ of (F, M, M): real and imaginary part of the whitened residual have unit variance."""
    diagonal = np.sqrt(np.maximum(np.einsum("fii->fi", covariance).real, 1e-300))
    scaled = covariance / diagonal[:, :, None] / diagonal[:, None, :]
    # 1e-12 of a unit diagonal: quantised channels that repeat exactly must not stop the fit
    lower = np.linalg.cholesky(scaled + 1e-12 * np.eye(covariance.shape[1]))
    root: Complex128 = np.sqrt(2.0) * np.linalg.inv(lower) / diagonal[:, None, :]
    return root


def stack(values: Complex128) -> Float64:
    """(F, M, n) complex to (2FM, n) real rows."""
    flat = values.reshape(-1, values.shape[-1])
    return np.concatenate((flat.real, flat.imag))


def factored(columns: Float64) -> tuple[Float64, Float64]:
    """(rows, rank) orthonormal basis of what the columns span, and (n, rank) from its coordinates to theirs.

    Cholesky's factor of the products, twice (Yamamoto et al. 2015): as orthogonal as a QR where the condition
    number is below 1e7, which the first pass shows, and several times faster on a few tall columns.
    """
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale == 0, 1.0, scale)
    scaled = columns / scale
    try:
        back = np.linalg.inv(np.linalg.cholesky(scaled.T @ scaled)).T
        basis = scaled @ back
        product = basis.T @ basis
        if np.abs(product - np.eye(product.shape[0])).max(initial=0.0) < 0.1:
            again = np.linalg.inv(np.linalg.cholesky(product)).T
            return basis @ again, (back @ again) / scale[:, None]
    except np.linalg.LinAlgError:
        pass
    left, size, right = np.linalg.svd(scaled, full_matrices=False)
    seen = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)  # no rows: rank 0
    return left[:, seen], right[seen].T / size[seen] / scale[:, None]
