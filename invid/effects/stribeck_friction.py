"""Stribeck friction: F = (coulomb + (static − coulomb)·exp(−(v/velocity)²)) · sgn(v).

The fall from static to sliding friction is a Gaussian in v, or an exponential in |v|; the data choose.
"""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128, Float64
from invid.effects.base import (
    Context,
    Effect,
    Family,
    Place,
    RecordMotion,
    Shape,
    direction,
    every_mass,
    velocity_grid,
)


def _fall(v: Float64, shape: Shape) -> Float64:
    kind, speed = shape
    result: Float64 = np.exp(-((v / speed) ** 2)) if kind == 0 else np.exp(-np.abs(v) / speed)
    return result


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    sign = direction(record, place)
    fall = _fall(record.velocity[:, place.a], shape)
    return np.stack((record.lines(sign), record.lines(sign * fall)), axis=1)


def _static(c: Float64, shape: Shape, v: float) -> float:
    return float(np.sign(v) * (c[0] + c[1] * _fall(np.array([v]), shape)[0]))


EFFECT = Effect(
    "stribeck_friction",
    Family.FRICTION,
    every_mass,
    lambda c, s: {"static": float(c[0] + c[1]), "coulomb": float(c[0]), "velocity": s[1]},
    {"static": "torque", "coulomb": "torque", "velocity": "velocity"},
    "Check lubrication: friction that falls with speed is boundary lubrication; expect stick-slip.",
    force=_force,
    grid=velocity_grid,
    variants=1,
    lower=(0.0, 0.0),
    nested=("coulomb_friction",),
    words="friction that falls from {static} at standstill to {coulomb} beyond {velocity}",
    static=_static,
)
