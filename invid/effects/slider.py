"""The elastoplastic element (a spring that slides at its limit), shared by two causes."""

from __future__ import annotations

import numpy as np
from numba import njit

from invid.arrays import Float64


@njit(cache=True)
def _march(x: np.ndarray, most: float, passes: int) -> np.ndarray:
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for _ in range(passes):
        for k in range(x.size):
            z = min(max(z + x[k] - last, -most), most)
            last = x[k]
            out[k] = z
    return out


def slide(x: Float64, most: float, *, periodic: bool) -> Float64:
    """(n,) displacement of a slider that gives way at ``most``; the periodic state where there is one."""
    out: Float64 = _march(np.ascontiguousarray(x), most, 2 if periodic else 1)
    return out
