"""Whether a motor stands on its friction, as far as its velocity shows it over its noise."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64

SLOW_RATIO = 4.0
"""Velocity over the softness of a reversal within which a motor may stand: six deviations of its noise."""
MOST_NOISE = 0.1
"""Largest velocity noise over the rms velocity with which standstill can be seen (empirical)."""
STOP_RATIO = 2.0
"""How many times as long as it takes to pass at the pace it came with a motor that stands stays below
``SLOW_RATIO``. One that only reverses, against twice its friction, leaves at a third of that pace."""


def sign_threshold(velocity: Float64, noise: float) -> float:
    """Velocity below which the sign of ``velocity`` (n,) is not known."""
    return max(1.5 * noise, 1e-4 * float(np.sqrt(np.mean(velocity**2))), 1e-300)


def standstill_velocity(velocity: Float64, noise: float) -> float:
    """Velocity within which a motor of ``velocity`` (n,) with ``noise`` may stand."""
    return SLOW_RATIO * sign_threshold(velocity, noise)


def is_seen_standing(velocity: Float64, noise: float) -> bool:
    """Return whether a motor of ``velocity`` (n,) with ``noise`` stands at times; not where noise hides
    it.
    """
    slow = standstill_velocity(velocity, noise)
    if slow > MOST_NOISE * float(np.sqrt(np.mean(velocity**2))):
        return False
    inside = np.abs(velocity) < slow
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(np.int8), [0]))))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if first < 2:
            continue
        pace = float(velocity[first - 2] - velocity[first - 1])
        if pace * velocity[first - 1] > 0.0 and end - first > STOP_RATIO * 2.0 * slow / abs(pace):
            return True
    return False
