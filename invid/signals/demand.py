"""The command within a recorded torque, where it is logged beside it."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.linear_algebra import real_rows

LATEST = 4
"""Samples by which a drive may report its torque after the demand."""
CLEARLY = 4.0
"""Factor in power by which a late command has to explain the torque better than a punctual one."""
LEAST_LINES = 4
"""Lines from which a hold of three numbers leaves something to compare."""
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
    axes = np.flatnonzero(np.abs(demand[at]).max(axis=0, initial=0.0) > 0.0)
    there = np.ix_(at, axes)
    late = samples_late((omega[at], position[there], torque[there]), demand[there], step)
    out = np.full_like(demand, np.nan)
    for i in axes if at.size >= LEAST_LINES else ():
        beside = _hold(omega[at], torque[at, i], demand[at, i], late * step)
        rest, hold = _beside(omega[at], position[at, i], beside)
        if rest < MOST_LEFT * hold:
            out[:, i] = demand[:, i]
    return out, late


def samples_late(lines: tuple[Float64, Complex128, Complex128], demand: Complex128, step: float) -> int:
    """Samples by which a demand (F, M) appears late in the recorded torque, the same for all axes.

    Without the demand the torque is the hold's: the right lag explains most of it. Zero unless another is
    better by ``CLEARLY``.
    """
    omega, position, torque = lines
    if omega.size < LEAST_LINES:
        return 0
    left = np.zeros(LATEST + 1)
    for theta, shown, command in zip(position.T, torque.T, demand.T, strict=True):
        power = max(float((np.abs(command) ** 2).sum()), 1e-300)
        for late in range(left.size):
            hold = _hold(omega, shown, command, late * step)
            left[late] += _beside(omega, theta, hold)[0] / power
    best = int(np.argmin(left))
    return best if CLEARLY * left[best] < left[0] else 0


def _hold(omega: Float64, torque: Complex128, demand: Complex128, late: float) -> Complex128:
    """(F,) what is beside a demand in torque that is recorded ``late`` [s]."""
    out: Complex128 = torque * np.exp(1j * omega * late) - demand
    return out


def _beside(omega: Float64, position: Complex128, hold: Complex128) -> tuple[float, float]:
    """Power of the torque beside a command that no hold makes, and all of it."""
    # The constant: what the ends of a record that does not close add to the spectrum of its velocity.
    law = real_rows(np.stack((position, 1j * omega * position, np.ones(position.size)), axis=1))
    seen = real_rows(hold[:, None])
    rest = seen - law @ np.linalg.lstsq(law, seen, rcond=None)[0]
    return float((rest**2).sum()), float((seen**2).sum())
