"""Gravity: F = torque · sin(q + angle) on the last mass of a branch."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_end, polar


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    x = record.position[:, place.a]
    return np.stack((record.lines(np.sin(x)), record.lines(np.cos(x))), axis=1)


EFFECT = Effect(
    "gravity",
    Family.POSITION,
    every_end,
    lambda c, _s: polar(c, "torque", "angle"),
    {"torque": "torque", "angle": "angle"},
    "Check the payload and the axis' orientation; add gravity compensation.",
    force=_force,
    words="gravity of {torque}",
)
