"""Viscous friction: F = coefficient · v."""

from __future__ import annotations

from invid.arrays import Complex128, Float64
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_mass


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    force: Complex128 = (1j * record.block.omega * record.q[:, place.a])[:, None]
    return force


def _static(c: Float64, _shape: Shape, v: float) -> float:
    return float(c[0]) * v


EFFECT = Effect(
    "viscous_friction",
    Family.FRICTION,
    every_mass,
    lambda c, _s: {"coefficient": float(c[0])},
    {"coefficient": "damping"},
    "Check the lubricant (grade, temperature, fill level).",
    force=_force,
    lower=(0.0,),
    words="viscous friction of {coefficient}",
    static=_static,
)
