"""Cogging: F = torque · sin(cycles_per_rev·θ + phase) at the motor, θ in rad."""

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
    every_motor,
    polar,
)


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    x = shape[0] * record.position[:, place.a]
    return np.stack((record.lines(np.sin(x)), record.lines(np.cos(x))), axis=1)


EFFECT = Effect(
    "cogging",
    Family.POSITION,
    every_motor,
    lambda c, s: {**polar(c, "torque", "phase"), "cycles_per_rev": s[0]},
    {"torque": "torque", "phase": "angle", "cycles_per_rev": "one"},
    "Normal for the motor type when small; a large value points at a damaged magnet or commutation.",
    force=_force,
    grid=cycles_grid,
    words="torque ripple of {torque}, {cycles_per_rev} times a revolution",
)
