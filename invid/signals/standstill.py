"""What dry friction is while the motor stands: whatever holds it, up to the limit.

A law of velocity has no value there. The torque that acts and what the first spring carries say it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Float64

SLOW = 4.0
"""Velocity over the softness of a reversal within which a motor may stand: six deviations of its noise."""
SEEN = 0.1
"""The same over the rms velocity, above which noise hides whether a motor stands. A guess."""
STOPS = 2.0
"""How many times as long as it takes to pass at the pace it came with a motor that stands stays below
``SLOW``. One that only reverses, against twice its friction, leaves at a third of that pace."""
LATER = 2
"""Samples after it moves again that count as standing: what acts is beyond the limit then, and is cut."""


@dataclass(frozen=True, eq=False)
class Standstill:
    """When a motor stands, sample by sample.

    Attributes
    ----------
    share
        (n,) part of each sample's interval in which it stands.
    last
        (n,) sample at which it last moved, where it stands; itself elsewhere.
    """

    share: Float64
    last: np.ndarray

    def held(self, moving: Float64, acting: Float64, low: float, high: float) -> Float64:
        """(n,) resistance: ``moving`` (n,) by a law; where it stands ``acting`` (n,) within limits."""
        out: Float64 = self.share * np.clip(acting, low, high) + (1.0 - self.share) * moving[self.last]
        return out


def sign_threshold(velocity: Float64, noise: float) -> float:
    """Velocity over which the sign of ``velocity`` (n,) is not told."""
    return max(1.5 * noise, 1e-3 * float(np.sqrt(np.mean(velocity**2))), 1e-300)


def standstill_velocity(velocity: Float64, noise: float) -> float:
    """Velocity within which a motor of ``velocity`` (n,) with ``noise`` may stand."""
    return SLOW * sign_threshold(velocity, noise)


def find_standstill(velocity: Float64, noise: float) -> Standstill | None:
    """When a motor of ``velocity`` (n,) with ``noise`` stands; none where it never does or noise hides it."""
    slow = standstill_velocity(velocity, noise)
    if slow > SEEN * float(np.sqrt(np.mean(velocity**2))):
        return None
    inside = np.abs(velocity) < slow
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(np.int8), [0]))))
    share, last = np.zeros(velocity.size), np.arange(velocity.size)
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if first < 2:
            continue
        pace = float(velocity[first - 2] - velocity[first - 1])
        if pace * velocity[first - 1] <= 0.0 or end - first <= STOPS * 2.0 * slow / abs(pace):
            continue
        stop = min(first - 1 + float(velocity[first - 1]) / pace, float(end))
        span = slice(first - 1, min(end + LATER, velocity.size))
        within = np.clip(np.arange(span.start, span.stop) + 0.5 - stop, 0.0, 1.0)
        share[span] = np.maximum(share[span], within)
        last[span] = first - 1
    return Standstill(share, last) if share.any() else None
