"""Torque saturation: the acting torque is clipped at ±limit while the record shows more."""

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
    every_axis,
    on_torque,
)


def _peak(context: Context, place: Place) -> float:
    return max(float(np.abs(r.torque[:, place.axis]).max()) for r in context.records)


def _direct(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    t = record.torque[:, place.axis]
    return on_torque(record, place.axis, -record.lines(np.clip(t, -shape[0], shape[0]) - t))


def _grid(context: Context, place: Place) -> list[Shape]:
    return [(_peak(context, place) * f,) for f in (0.97, 0.92, 0.85, 0.75, 0.6, 0.45)]


EFFECT = Effect(
    "torque_saturation",
    Family.ACTUATOR,
    every_axis,
    lambda _c, s: {"limit": s[0]},
    {"limit": "torque"},
    "Check the drive's torque or current limit (0x6072) against the excitation.",
    direct=_direct,
    grid=_grid,
    unit_coefficient=True,
    words="torque clipped at {limit}",
    within=lambda c, p, s: s[0] < _peak(c, p),
)
