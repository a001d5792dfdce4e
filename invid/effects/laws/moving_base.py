"""The body that all loads stand on: how its motion shakes them, from shares and the loads' inertia.

q (M,) are the loads relative to the body, as the drives see them, and x is the motion of the body, in which
load i takes part with the share sᵢ: T = ½(q̇ + sẋ)ᵀJ(q̇ + sẋ) + ½mẋ² with the inertia J (M, M) of the loads,
couplings included.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from invid.numerics.arrays import Float64

SHARE = "share_"
"""Beginning of the name of a share; the number of the axis, from 1, follows."""


def shares_of(p: Mapping[str, float], axes: int) -> Float64:
    """(M,) share of each load in the body's motion, 1 where none is said."""
    return np.array([p.get(f"{SHARE}{i + 1}", 1.0) for i in range(axes)])


def moved_by_base(p: Mapping[str, float], inertia: Float64) -> tuple[float, Float64]:
    """Mass of the body with all that stands on it, and (M,) inertial force on each load per acceleration."""
    shares = shares_of(p, inertia.shape[0])
    force: Float64 = inertia @ shares
    return p["mass"] + float(shares @ force), force
