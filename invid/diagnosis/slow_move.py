"""Slow moves of a recording as means over stretches that are long beside its flexible modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.errors import InvidError
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Kind, Recording
from invid.signals.timebase import resample_uniformly

LONGEST, SHORTEST = 0.5, 0.1
"""Longest and shortest stretch [s] that counts as one observation: slow beside the flexible modes, short
beside a move. Neighbouring stretches are not quite independent; the evidence is halved for that."""
STRETCHES = 20
"""Least number of stretches of a move, unless they get too short: the regressions have up to eight
numbers."""


@dataclass(frozen=True, eq=False)
class SlowMove:
    """Means over n stretches of one slow move: (n, M) velocity, acceleration and torque.

    ``path`` (samples, M) is the position, ``rows`` the length of a stretch in samples.
    """

    path: Float64
    rows: int
    velocity: Float64
    acceleration: Float64
    torque: Float64


def find_slow_moves(recording: Recording) -> tuple[SlowMove, ...]:
    """The slow moves of a recording that are long enough for a regression."""
    found = (_move(e) for e in recording.experiments if e.kind is Kind.CONSTANT_VELOCITY)
    return tuple(m for m in found if m is not None)


def _move(experiment: Experiment) -> SlowMove | None:
    try:
        data = resample_uniformly(experiment)
    except InvidError:
        return None
    length = data.position.shape[0]
    rows = min(round(LONGEST / data.step), length // (STRETCHES + 2))
    if rows * data.step < SHORTEST or rows < 2:
        return None
    q, at = data.position, np.arange(rows, length - rows, rows)
    velocity = (q[at + rows] - q[at - rows]) / (2 * rows * data.step)
    acceleration = (q[at + rows] - 2.0 * q[at] + q[at - rows]) / (rows * data.step) ** 2
    return SlowMove(q, rows, velocity, acceleration, stretch_means(data.torque, rows))


def stretch_means(values: Float64, rows: int) -> Float64:
    """(n, L) means of (samples, L) under triangles of half-width ``rows``.

    The second difference of the position over that distance is the mean acceleration under the same triangle,
    so fast motion cancels alike on both sides of the equation.
    """
    triangle = np.convolve(np.ones(rows), np.ones(rows)) / rows**2
    at = np.arange(rows, values.shape[0] - rows, rows)
    out: Float64 = np.stack([np.convolve(c, triangle, mode="same")[at] for c in values.T], axis=1)
    return out
