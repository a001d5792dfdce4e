"""Linear algebra on data: complex lines as real rows, least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from invid.numerics.arrays import Float64


def real_rows(values: npt.NDArray[Any]) -> Float64:
    """(2n, …) real and imaginary parts of (n, …) one below the other."""
    rows: Float64 = np.concatenate((values.real, values.imag))
    return rows


def least_squares(columns: Float64, right: Float64, rcond: float | None = None) -> Float64:
    """(n,) or (n, k) coefficients of the columns (rows, n), which are scaled to unit length meanwhile."""
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0] = 1.0
    found: Float64 = np.linalg.lstsq(columns / scale, right, rcond=rcond)[0]
    scaled: Float64 = (found.T / scale).T
    return scaled
