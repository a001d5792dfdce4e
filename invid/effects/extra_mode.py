"""Extra mode: a mass on a spring, attached to a mass of the chain."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_mass

LOSS = 0.01
"""Loss factor 2ζ given to the attached mode, so that its column is finite on a line at its frequency;
empirical: half a per cent of critical damping, the low end of what drives show."""


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    w = record.block.omega
    ratio = w / shape[0]
    dynamic = -(w**2) * (1.0 + 1j * LOSS * ratio) / (1.0 - ratio**2 + 1j * LOSS * ratio)
    force: Complex128 = (dynamic * record.q[:, place.a])[:, None]
    return force


def _grid(context: Context, _place: Place) -> list[Shape]:
    low = min(float(r.block.omega[r.block.omega > 0][0]) for r in context.records)
    return [(float(w),) for w in np.geomspace(max(4 * low, context.top / 40), 1.05 * context.top, 60)]


EFFECT = Effect(
    "extra_mode",
    Family.STRUCTURE,
    every_mass,
    lambda c, s: {"mass": float(c[0]), "stiffness": float(c[0] * s[0] ** 2)},
    {"mass": "inertia", "stiffness": "stiffness"},
    "Something attached swings: check cables, covers, tool and base; or declare one mass more.",
    force=_force,
    grid=_grid,
    lower=(0.0,),
    words="a further mass of {mass} on a spring of {stiffness}",
)
