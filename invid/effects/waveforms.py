"""Rate-independent hysteresis along a given motion, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from invid.arrays import Float64


@njit(cache=True)  # type: ignore[untyped-decorator]
def elastoplastic(x: Float64, reach: float, rounds: int) -> Float64:
    """A spring that slips: state in −1…1, slope 1/reach while it sticks (Prandtl, Jenkins).

    ``rounds`` passes over the waveform; two bring a periodic one to its steady loop.
    """
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for _ in range(rounds):
        for k in range(x.size):
            z = min(max(z + (x[k] - last) / reach, -1.0), 1.0)
            last = x[k]
            out[k] = z
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def dahl(x: Float64, reach: float, rounds: int) -> Float64:
    """dz = dx/reach · (1 − sgn(dx)·z) (Dahl 1968), each step integrated exactly."""
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for _ in range(rounds):
        for k in range(x.size):
            step = (x[k] - last) / reach
            last = x[k]
            if step > 0.0:
                z = 1.0 + (z - 1.0) * np.exp(-step)
            else:
                z = -1.0 + (z + 1.0) * np.exp(step)
            out[k] = z
    return out
