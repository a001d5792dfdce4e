"""Cubic stiffness: the spring adds coefficient · deflection³."""

from __future__ import annotations

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_spring


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    d = record.deflection(place.a, place.b if place.b is not None else place.a)
    return record.lines((d - d.mean()) ** 3)[:, None]


EFFECT = Effect(
    "cubic_stiffness",
    Family.SPRING,
    every_spring,
    lambda c, _s: {"coefficient": float(c[0])},
    {"coefficient": "cubic"},
    "Normal for harmonic drives and elastomer couplings; use the extended model.",
    force=_force,
    words="a spring that changes with load, {coefficient}",
)
