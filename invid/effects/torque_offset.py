"""Torque offset: a constant resisting torque. Only the mean torque of a free axis shows it."""

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
    every_axis,
    on_torque,
)


def _direct(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    return on_torque(record, place.axis, record.lines(np.ones(record.torque.shape[0])))


def _static(c: Float64, _shape: Shape, _v: float) -> float:
    return float(c[0])


EFFECT = Effect(
    "torque_offset",
    Family.STATIC,
    every_axis,
    lambda c, _s: {"torque": float(c[0])},
    {"torque": "torque"},
    "Check the drive's current offset, and whether a load pulls on the axis.",
    direct=_direct,
    words="a constant torque of {torque}",
    static=_static,
)
