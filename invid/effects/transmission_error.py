"""Transmission error: the spring's rest position runs with amplitude · sin(cycles_per_rev·θ + phase)."""

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
    cycles_grid,
    every_spring,
    polar,
)


def _force(context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    x = shape[0] * record.position[:, place.a]
    k = -context.springs[place.spring]
    return np.stack((record.lines(k * np.sin(x)), record.lines(k * np.cos(x))), axis=1)


EFFECT = Effect(
    "transmission_error",
    Family.SPRING,
    every_spring,
    lambda c, s: {**polar(c, "amplitude", "phase"), "cycles_per_rev": s[0]},
    {"amplitude": "position", "phase": "angle", "cycles_per_rev": "one"},
    "Check gear teeth and bearings of this stage.",
    force=_force,
    grid=cycles_grid,
    words="a transmission error of {amplitude}, {cycles_per_rev} times a revolution",
)
