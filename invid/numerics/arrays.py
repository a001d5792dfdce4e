"""Array types and the one way arrays enter a frozen dataclass: as read-only copies."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Float64: TypeAlias = npt.NDArray[np.float64]
Complex128: TypeAlias = npt.NDArray[np.complex128]
Int64: TypeAlias = npt.NDArray[np.int64]
UInt16: TypeAlias = npt.NDArray[np.uint16]
Bool: TypeAlias = npt.NDArray[np.bool_]


def frozen(values: npt.ArrayLike, dtype: npt.DTypeLike = np.float64) -> npt.NDArray[np.generic]:
    """A C-contiguous, read-only copy of ``values``."""
    array = np.array(values, dtype=dtype, order="C", copy=True)
    array.setflags(write=False)
    return array


def frozen_float(values: npt.ArrayLike) -> Float64:
    """Read-only float64 copy."""
    array: Float64 = np.array(values, dtype=np.float64, order="C", copy=True)
    array.setflags(write=False)
    return array
