"""Dry friction in a model document: abrupt, or with a sign that changes over a range of velocity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.numerics.arrays import Float64

ROUNDING = "rounding"
"""Name of the additional parameter of friction in a model: the velocity over which its sign changes,
tanh(v/rounding) [rad/s or m/s]."""


def stribeck_decay(velocity: Float64, shape: Sequence[float]) -> Float64:
    """(n,) exp(−(|v|/v₀)^exponent), ``shape`` (v₀, exponent): the part of friction at low speed alone."""
    out: Float64 = np.exp(-((np.abs(velocity) / (shape[0] or 1.0)) ** max(int(shape[1]), 1)))
    return out
