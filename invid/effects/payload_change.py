"""Payload change: the last mass grows by ``mass`` at ``time`` (on the recording's clock)."""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_end


def _force(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    length = max(record.end_s - record.start_s, 1e-9)
    share = float(np.clip((record.end_s - shape[0]) / length, 0.0, 1.0))
    force: Complex128 = (-share * record.block.omega**2 * record.q[:, place.a])[:, None]
    return force


def _grid(context: Context, _place: Place) -> list[Shape]:
    """Between any two records, and at thirds of each."""
    edges = sorted((r.start_s, r.end_s) for r in context.records)
    times = [0.5 * (a[1] + b[0]) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    times += [a + f * (b - a) for a, b in edges for f in (1 / 3, 2 / 3)]
    return [(t,) for t in sorted(times)]


EFFECT = Effect(
    "payload_change",
    Family.TIME,
    every_end,
    lambda c, s: {"mass": float(c[0]), "time": s[0]},
    {"mass": "inertia", "time": "time"},
    "Check whether the tool lost or gained a part during the measurement.",
    force=_force,
    grid=_grid,
    words="a payload that changed by {mass} at {time}",
)
