"""Coupling stiffness: a spring between the last masses of two branches."""

from __future__ import annotations

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_pair


def _force(_context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    b = place.b if place.b is not None else place.a
    force: Complex128 = (record.q[:, place.a] - record.q[:, b])[:, None]
    return force


EFFECT = Effect(
    "coupling_stiffness",
    Family.STRUCTURE,
    every_pair,
    lambda c, _s: {"stiffness": float(c[0])},
    {"stiffness": "stiffness"},
    "Check what joins the two axes: a cable harness, a hose, a shared frame.",
    force=_force,
    lower=(0.0,),
    words="a spring of {stiffness} between the two axes",
)
