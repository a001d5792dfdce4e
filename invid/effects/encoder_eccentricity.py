"""Encoder eccentricity: the encoder reads θ + amplitude·sin(θ + phase)."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_axis, polar


def _direct(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    x = record.position[:, place.a]
    z = record.stiffness[:, :, place.axis]
    columns = [-z * record.lines(w - w.mean())[:, None] for w in (np.sin(x), np.cos(x))]
    return np.stack(columns, axis=2)


EFFECT = Effect(
    "encoder_eccentricity",
    Family.SENSOR,
    every_axis,
    lambda c, _s: polar(c, "amplitude", "phase"),
    {"amplitude": "position", "phase": "angle"},
    "Check the encoder's mounting and coupling.",
    direct=_direct,
    words="an encoder error of {amplitude} once a revolution",
)
