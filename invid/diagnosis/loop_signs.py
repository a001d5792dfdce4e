"""What a record shows of the loop, not of the mechanics: torque at its limit, a swing at a constant goal."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64
from invid.recording.cannot_tell import what_it_cannot_tell
from invid.recording.model import Experiment, Recording

STANDS_S = 0.5
"""Shortest time for which a goal must stand (a convention: some periods of what a position loop does)."""
PURE = 0.5
"""Share of the power of a motion that one frequency must hold: noise spreads, and a friction's creep has none
(empirical)."""
COUNTS = 5.0
"""Counts of the encoder, peak, from which a swing is more than the last count turning to and fro."""


def loop_signs(recording: Recording) -> tuple[dict[str, Any], ...]:
    """A row an axis and sign, plain values: ``at_limit`` (``limit``, ``share`` of the rows) or ``swings``
    (``amplitude``, ``frequency_hz``)."""
    limits = [lack for lack in what_it_cannot_tell(recording) if lack.code == "torque_at_limit"]
    rows = [{"sign": "at_limit", "axis": lack.axis, **lack.values} for lack in limits]
    return (*rows, *_swings(recording))


def _swings(recording: Recording) -> Iterator[dict[str, Any]]:
    counts = recording.encoder_resolution
    for i, axis in enumerate(recording.axes):
        least = 0.0 if counts is None else COUNTS * float(np.nan_to_num(counts[i]))
        found = [s for e in recording.experiments if (s := _swing(e, i)) is not None and s[0] > least]
        if found:
            amplitude, frequency = max(found)
            yield {"sign": "swings", "axis": axis, "amplitude": amplitude, "frequency_hz": frequency}


def _swing(e: Experiment, axis: int) -> tuple[float, float] | None:
    """Amplitude and frequency of the purest motion while the goal of a known controller stands."""
    if e.position_reference is None:
        return None
    goal, told = e.position_reference[:, axis], e.torque_feedforward
    moved = np.flatnonzero((np.diff(goal) != 0) | (False if told is None else np.diff(told[:, axis]) != 0))
    edges = [0, *(moved + 1).tolist(), goal.size]
    first, last = max(pairwise(edges), key=lambda rows: rows[1] - rows[0])
    if last - first < STANDS_S * e.sample_rate_hz:
        return None
    return _tone(e.position[first:last, axis], e.sample_rate_hz)


def _tone(position: Float64, rate: float) -> tuple[float, float] | None:
    """Amplitude and frequency of a motion that does not die away; ``None`` where none holds ``PURE``."""
    rows = np.arange(position.size)
    away = position - np.polyval(np.polyfit(rows, position, 1), rows)
    half = away.size // 2
    power = np.abs(np.fft.rfft(away * np.hanning(away.size))) ** 2
    at = int(power[2:].argmax()) + 2 if power.size > 4 else 0
    early, late = float(np.std(away[:half])), float(np.std(away[half:]))
    if not at or late < 0.5 * early or power[at - 1 : at + 2].sum() < PURE * power.sum() or not late > 0:
        return None
    return float(np.sqrt(2.0) * late), float(at * rate / position.size)
