"""Torque gain of one axis relative to the others: reciprocity, G_ij = G_ji, gives it away."""

from __future__ import annotations

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
from invid.refine.structure import ChainStructure


def _places(s: ChainStructure) -> tuple[Place, ...]:
    return every_axis(s) if s.motors > 1 else ()


def _direct(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    return on_torque(record, place.axis, -record.block.torque[:, place.axis])


EFFECT = Effect(
    "torque_gain",
    Family.ACTUATOR,
    _places,
    lambda c, _s: {"gain": 1.0 + float(c[0])},
    {"gain": "one"},
    "Check the rated torque (0x6076) and torque constant set in this drive.",
    direct=_direct,
    lower=(-0.95,),
    words="a torque {gain} times what the drive reports",
)
