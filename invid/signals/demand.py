"""The command within a recorded torque, where it is logged beside it."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.linear_algebra import real_rows

LATEST = 4
"""Samples by which a drive may report its torque after the demand."""
CLEARLY = 4.0
"""Factor in power by which a late command has to explain the torque better than a punctual one."""
MOST_LEFT = 0.1
"""Share of its power that a hold may leave of the torque beside a command: else that is none, or the hold's
torque is within the command (empirical)."""


def command_within(
    lines: tuple[Float64, Complex128, Complex128], demand: Complex128, step: float
) -> tuple[Complex128, int]:
    """(A, M) the demand and the samples by which the recorded torque shows it late, the same for all axes.

    NaN on axes whose torque beside it is no hold's. ``lines``: [rad/s], position, torque; ``demand`` (A, M).
    Without the command the torque is the hold's, −(P + jωD)·position: the right lag explains most of it.
    """
    omega, position, torque = lines
    power = (np.abs(demand) ** 2).sum(axis=1)
    at = np.flatnonzero(power > 1e-3 * power.max())
    earlier = np.exp(1j * omega[at] * step)[:, None]
    holds = [torque[at] * earlier**lag - demand[at] for lag in range(LATEST + 1)]
    left = np.array(
        [[_beside(omega[at], p, h) for p, h in zip(position[at].T, hold.T, strict=True)] for hold in holds]
    )
    whole = left[..., 0].sum(axis=1)
    best = int(np.argmin(whole))
    late = best if CLEARLY * whole[best] < whole[0] else 0
    rest, hold = left[late].T
    return np.where(rest < MOST_LEFT * hold, demand, np.nan), late


def _beside(omega: Float64, position: Complex128, hold: Complex128) -> tuple[float, float]:
    """Power of the torque beside a command that no hold makes, and all of it."""
    # The constant: what the ends of a record that does not close add to the spectrum of its velocity.
    law = real_rows(np.stack((position, 1j * omega * position, np.ones(position.size)), axis=1))
    seen = real_rows(hold[:, None])
    rest = seen - law @ np.linalg.lstsq(law, seen, rcond=None)[0]
    return float((rest**2).sum()), float((seen**2).sum())
