"""Friction that differs by direction: F = c₊ + b₊v for v > 0 and −c₋ + b₋v for v < 0."""

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
    every_motor,
)

_NAMES = ("coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative")


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    sign, v = direction(record, place), record.velocity[:, place.a]
    waves = (0.5 * (1.0 + sign), -0.5 * (1.0 - sign), np.maximum(v, 0.0), np.minimum(v, 0.0))
    return np.stack([record.lines(w) for w in waves], axis=1)


def _static(c: Float64, _shape: Shape, v: float) -> float:
    return float(c[0] + c[2] * v) if v > 0 else float(-c[1] + c[3] * v)


EFFECT = Effect(
    "asymmetric_friction",
    Family.FRICTION,
    every_motor,
    lambda c, _s: dict(zip(_NAMES, map(float, c), strict=True)),
    {
        "coulomb_positive": "torque",
        "coulomb_negative": "torque",
        "viscous_positive": "damping",
        "viscous_negative": "damping",
    },
    "Check for wear on one flank of screw or gear.",
    force=_force,
    lower=(0.0, 0.0, 0.0, 0.0),
    nested=("coulomb_friction", "viscous_friction", "torque_offset"),
    words="friction that differs by direction ({coulomb_positive} forward, {coulomb_negative} back)",
    static=_static,
)
