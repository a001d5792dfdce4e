"""Coulomb friction: F = torque · sgn(v)."""

from __future__ import annotations

from invid.arrays import Complex128, Float64
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, direction, every_mass


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    return record.lines(direction(record, place))[:, None]


def _static(c: Float64, _shape: Shape, v: float) -> float:
    return float(c[0]) * (1.0 if v > 0 else -1.0)


EFFECT = Effect(
    "coulomb_friction",
    Family.FRICTION,
    every_mass,
    lambda c, _s: {"torque": float(c[0])},
    {"torque": "torque"},
    "Check brake release, seals and lubrication.",
    force=_force,
    lower=(0.0,),
    words="dry friction of {torque}",
    static=_static,
)
