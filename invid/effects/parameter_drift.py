"""Parameter drift: a spring changes at ``rate`` (share of its value a second) during the measurement."""

from __future__ import annotations

from invid.arrays import Complex128
from invid.effects.base import Context, Effect, Family, Place, RecordMotion, Shape, every_spring


def _force(context: Context, record: RecordMotion, place: Place, _shape: Shape) -> Complex128:
    b = place.b if place.b is not None else place.a
    first = min(r.start_s for r in context.records)
    middle = 0.5 * (record.start_s + record.end_s) - first
    pull = middle * context.springs[place.spring] * (record.q[:, place.a] - record.q[:, b])
    force: Complex128 = pull[:, None]
    return force


EFFECT = Effect(
    "parameter_drift",
    Family.TIME,
    every_spring,
    lambda c, _s: {"rate": float(c[0])},
    {"rate": "rate"},
    "Check temperature: let the robot warm up, then measure again.",
    force=_force,
    words="a spring that drifts by {rate}",
)
