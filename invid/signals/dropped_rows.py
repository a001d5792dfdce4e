"""Dropped samples: rows that repeat the one before more often than noise explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.special import erfinv

from invid.numerics.arrays import Bool, Float64
from invid.numerics.distributions import binomial_sf
from invid.recording.model import Experiment, Recording

FALSE_ALARM = 1e-4
"""Chance, over all axes, that repeated rows of an intact recording are called dropped (statistical)."""
MOST_REPEAT_CHANCE = 0.05
"""Largest chance of a position to repeat at which a row of a held axis is used. Empirical; only the
sensitivity on held axes depends on it."""
MODEL_FACTOR = 2.0
"""Factor by which the repeats of a rounded signal may differ from what its speed and noise predict
(empirical)."""
CHANCE_ERROR = 0.2
"""Relative error of the number of rows that repeat by chance. Empirical, eight hidden records: half to once
of it where there were few, within a tenth where there were many."""
RARE_SHARE = 0.3
"""Chance of a row to repeat, over the lost share, up to which it hardly repeats (empirical). The share is
estimated from all rows and from these alone; the smaller error decides."""
NODES = np.sqrt(2.0) * erfinv(np.linspace(-0.975, 0.975, 40))
"""40 standard normal deviates of equal weight: nodes of a mean over noise."""


@dataclass(frozen=True)
class DroppedRows:
    """Share of the rows of one axis that were dropped, with its standard deviation."""

    axis: int
    fraction: float
    std: float


def _repeated_rows(e: Experiment, axis: int) -> tuple[Bool, Float64, Float64]:
    """(n − 1,) rows that repeat exactly, the largest chance that they do without loss, and the expected
    chance.

    Chance: the product of how often each channel alone repeats nearby (quantised channels do), over a second
    either side, without rows in which both repeat; or of how often they do where both reverse, as those of a
    slow sinusoid do at once. The torque of a held axis follows from its position and repeats with it: only
    rows count there at which the position is too fast to repeat; the others have no chance (NaN).
    """
    steps_p, steps_t = np.diff(e.position[:, axis]), np.diff(e.torque[:, axis])
    same_p, same_t = steps_p == 0, steps_t == 0
    both: Bool = same_p & same_t
    window = max(min(int(e.sample_rate_hz), both.size // 4), 8)

    first = np.arange(both.size) - window // 2
    edges = np.clip((first, first + window), 0, both.size)

    def nearby(flags: Bool) -> Float64:
        counted: Float64 = np.diff(np.concatenate(([0.0], np.cumsum(flags)))[edges], axis=0)[0]
        return counted

    def chance_nearby(flags: Bool) -> Float64:
        # Share of repeats of one channel among the rows that do not repeat as a whole.
        out: Float64 = nearby(flags & ~both) / np.maximum(nearby(~both), 1.0)
        return out

    p, t = chance_nearby(same_p), chance_nearby(same_t)
    # P(both) = P(p)·P(t) for independent channels, from P(p and not t) = P(p)(1 − P(t)) and so on.
    chance: Float64 = np.clip(p * t / np.maximum(1.0 - p - t + p * t, 1e-6) * (1 + p + t), 0.0, 1.0)
    repeat_p = _repeat_chance(steps_p)
    if e.excited_axis not in (-1, axis):
        most = np.where(repeat_p > MOST_REPEAT_CHANCE, np.nan, np.maximum(chance, repeat_p))
        return both, most, most
    repeat_t = _repeat_chance(steps_t)
    most = np.maximum(chance, repeat_p * repeat_t)
    return both, most, _joint_chance((repeat_p, repeat_t), (same_p & ~both, same_t & ~both), most)


def _joint_chance(chances: tuple[Float64, Float64], alone: tuple[Bool, Bool], most: Float64) -> Float64:
    """(n − 1,) chance that two rounded signals repeat in the same row, scaled to how often each repeats
    alone.

    The larger of two estimates row by row would be more than either: it made 0.9 % of 1.4 % lost in one
    hidden case. Where the signals do not repeat as rounded ones do, ``most`` is returned.
    """
    out: Float64 = chances[0] * chances[1]
    for own, other, observed in zip(chances, chances[::-1], alone, strict=True):
        expected = float((own * (1.0 - other)).sum())
        if expected <= 0.0 or not 1.0 / MODEL_FACTOR < observed.sum() / expected < MODEL_FACTOR:
            return most
        out = out * float(observed.sum() / expected)
    return np.minimum(out, most)


def _repeat_chance(steps: Float64) -> Float64:
    """(n − 1,) chance that a rounded signal repeats, from its local speed and its noise.

    Rounded to q, a signal that moves by d from row to row stays in its step with the chance 1 − |d|/q.
    """
    size = np.abs(steps)
    if not size.any():
        return np.ones_like(steps)
    unit = float(size[size > 0].min())
    slope = np.convolve(steps, np.array([1.0, 1.0, 0.0, 1.0, 1.0]) / 4.0, mode="same")
    # Of white noise of variance v the bend has 5 v, of which rounding is q²/12; a step has 2 v.
    bend = 1.4826 * float(np.median(np.abs(steps[1:-1] - 0.5 * (steps[:-2] + steps[2:]))))
    spread = np.sqrt(2.0 * max(bend**2 / 5.0 - unit**2 / 12.0, 0.0))
    out = np.zeros_like(steps)
    for node in NODES:
        out += np.clip(1.0 - np.abs(slope + spread * node) / unit, 0.0, 1.0) / NODES.size
    return out


def find_dropped_rows(recording: Recording) -> list[DroppedRows]:
    """Axes whose rows repeat more often than by chance, with the share lost."""
    out = []
    for axis in range(recording.axis_count):
        parts = [
            _repeated_rows(e, axis)
            for e in recording.experiments
            if float(np.std(e.position[:, axis])) > 0 and float(np.std(e.torque[:, axis])) > 0
        ]
        if not parts:
            continue
        both, most, expected = (np.concatenate(p) for p in zip(*parts, strict=True))
        countable = np.isfinite(most)
        repeated, rows = int(both[countable].sum()), int(countable.sum())
        if rows == 0 or repeated < 5:
            continue
        p0 = min(max(1.5 * float(most[countable].sum()) / rows, 1e-9), 1.0)
        if binomial_sf(repeated - 1, rows, p0) > FALSE_ALARM / recording.axis_count:
            continue
        out.append(_dropped_share(axis, both[countable], expected[countable]))
    return out


def _dropped_share(axis: int, both: Bool, chances: Float64) -> DroppedRows:
    """The lost share of one axis, from all rows or from those that hardly repeat by chance, whichever is
    surer."""

    def share_of(rows: Bool) -> tuple[float, float]:
        repeated, chance, count = float(both[rows].sum()), float(chances[rows].sum()), float(rows.sum())
        return (repeated - chance) / (count - chance), np.hypot(
            np.sqrt(repeated), CHANCE_ERROR * chance
        ) / count

    every = np.ones(both.size, dtype=bool)
    is_rare = chances < RARE_SHARE * share_of(every)[0]
    options = [share_of(rows) for rows in (every, is_rare) if both[rows].sum() >= 5]
    share, std = min(options, key=lambda o: o[1])
    return DroppedRows(axis, float(share), float(std))


def interpolate_dropped_rows(recording: Recording, dropped: Sequence[DroppedRows]) -> Recording:
    """The recording with the repeated rows of those axes interpolated from their neighbours."""
    experiments = []
    for e in recording.experiments:
        position, torque = e.position.copy(), e.torque.copy()
        for d in dropped:
            both, _, _ = _repeated_rows(e, d.axis)
            lost = np.concatenate(([False], both))
            kept = np.flatnonzero(~lost)
            if kept.size < 8:
                continue
            at = np.flatnonzero(lost)
            for channel in (position, torque):
                channel[at, d.axis] = _interpolate(e.time, channel[:, d.axis], kept, at)
        experiments.append(replace(e, position=position, torque=torque))
    return replace(recording, experiments=tuple(experiments))


def _interpolate(time: Float64, values: Float64, kept: np.ndarray, at: np.ndarray) -> Float64:
    out: Float64 = scipy.interpolate.CubicSpline(time[kept], values[kept])(time[at])
    return out
