"""Backlash: free play of ``gap`` in all; the spring carries K·(δ − clip(δ, ±gap/2))."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_spring


def _force(context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    d = record.deflection(place.a, place.b if place.b is not None else place.a)
    half = 0.5 * shape[0]
    return record.lines(-context.springs[place.spring] * np.clip(d, -half, half))[:, None]


def _grid(context: Context, place: Place) -> list[Shape]:
    s = context.span(place.a, place.b)
    return [(s * f,) for f in (0.01, 0.03, 0.08, 0.2, 0.4, 0.6, 0.8)]


EFFECT = Effect(
    "backlash",
    Family.SPRING,
    every_spring,
    lambda _c, s: {"gap": s[0]},
    {"gap": "position"},
    "Check gear, keyway and coupling for play.",
    force=_force,
    grid=_grid,
    unit_coefficient=True,
    words="free play of {gap}",
    within=lambda c, p, s: s[0] < c.span(p.a, p.b),
)
