"""Presliding friction: a spring of ``stiffness`` that slips at ``torque`` (elastoplastic, or Dahl's law)."""

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
    every_mass,
    reach_grid,
)
from invid.effects.waveforms import dahl, elastoplastic


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    kind, reach = shape
    x = np.ascontiguousarray(record.position[:, place.a])
    law = elastoplastic if kind == 0 else dahl
    return record.lines(law(x, reach, 2 if record.periodic else 1))[:, None]


def _static(c: Float64, _shape: Shape, v: float) -> float:
    return float(c[0]) * (1.0 if v > 0 else -1.0)


EFFECT = Effect(
    "presliding_friction",
    Family.FRICTION,
    every_mass,
    lambda c, s: {"stiffness": float(c[0] / s[1]), "torque": float(c[0])},
    {"stiffness": "stiffness", "torque": "torque"},
    "Check bearing preload and seals: the contact yields before it slides.",
    force=_force,
    grid=reach_grid,
    variants=1,
    lower=(0.0,),
    nested=("coulomb_friction",),
    words="friction of {torque} that yields with {stiffness} before it slides",
    static=_static,
)
