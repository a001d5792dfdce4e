"""Eigenvalues of a matrix that data have made, which may have none that can be computed."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64


def eigenvalues(matrix: Float64) -> Complex128 | None:
    """(n,) eigenvalues of an (n, n) matrix; ``None`` where it is not finite or LAPACK finds none."""
    if not np.isfinite(matrix).all():
        return None
    try:
        out: Complex128 = np.linalg.eigvals(matrix).astype(np.complex128)
    except np.linalg.LinAlgError:
        return None
    return out
