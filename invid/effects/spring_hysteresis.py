"""Spring hysteresis: an elastoplastic element (stiffness, slipping at torque) parallel to the spring."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import (
    Context,
    Effect,
    Family,
    Place,
    RecordMotion,
    Shape,
    every_spring,
    reach_grid,
)
from invid.effects.waveforms import dahl, elastoplastic


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    kind, reach = shape
    x = np.ascontiguousarray(record.deflection(place.a, place.b if place.b is not None else place.a))
    law = elastoplastic if kind == 0 else dahl
    return record.lines(law(x, reach, 2 if record.periodic else 1))[:, None]


EFFECT = Effect(
    "spring_hysteresis",
    Family.SPRING,
    every_spring,
    lambda c, s: {"stiffness": float(c[0] / s[1]), "torque": float(c[0])},
    {"stiffness": "stiffness", "torque": "torque"},
    "Check clamped joints, belts and flexsplines for slip.",
    force=_force,
    grid=reach_grid,
    variants=1,
    lower=(0.0,),
    words="hysteresis of {torque}",
)
