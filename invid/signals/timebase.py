"""Put samples with jitter, late stamps and losses on a uniform grid.

Spectra want equidistant samples. ``invid.recording.clock`` counts which slot of an even clock each row is.
How far a stamp is off its slot may be true (the drive was asked late) or the logger's (it stamped late): the
motion tells, for a sample taken late lies further along it. Where rows are even they stay as they are; else a
quintic B-spline on the even grid is fitted to them by least squares, with a penalty on what moves faster than
a record can hold, which also bridges a slot or two without a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from invid.errors import RecordingError
from invid.numerics.arrays import Bool, Float64, Int64
from invid.recording.clock import Slots, count_slots
from invid.recording.model import Experiment

EVEN_ERROR = 1e-3
"""Timing error in samples below which instants count as even: at a tenth of the sample rate it moves
a sample by 6e-4 of the amplitude, incoherently, so 1e-5 of a line of a thousand samples or more."""

LONGEST_GAP = 3
"""Steps between two samples up to which the spline is trusted: with two samples lost it is off by 0.4 % of
the amplitude at a tenth of the sampling rate and by a fifth at a fifth, with five by 13 % and three times."""

PENALTY = 1e-7
"""Weight of the squared sixth differences of the spline's coefficients: takes 2e-6 of the amplitude at
a fifth of the sample rate, 2e-4 at three tenths, and keeps samples at nearly one instant from tearing the
spline."""

STAMPS_RIGHT = 0.5
"""Standard deviation of the belief, before any look at the motion, that stamps are the instants of sampling
(1) as a recording's ``time`` is meant; the motion of most records says it fifty times closer."""

WHITE = 0.01
"""Power of the lateness's sixth differences over that of a white one (924 times its variance) from which the
motion is asked: single late stamps have less than a white jitter, a slow swing nothing (empirical)."""


@dataclass(frozen=True, eq=False)
class UniformRecord:
    """An experiment on a uniform grid of step ``step`` [s]; ``lost`` samples were missing."""

    step: float
    position: Float64
    torque: Float64
    lost: int
    longest_gap: int

    @property
    def samples(self) -> int:
        """Samples on the grid."""
        return int(self.position.shape[0])


def resample_uniformly(experiment: Experiment) -> UniformRecord:
    """The experiment on an even grid; RecordingError where time is unusable."""
    time = np.asarray(experiment.time, dtype=float)
    count = time.size
    if count < 8:
        raise RecordingError(
            f"experiment {experiment.key}: {count} samples are too few for a spectrum; record at least 8"
        )
    steps = np.diff(time)
    if not np.all(steps > 0):
        at = int(np.argmax(steps <= 0))
        raise RecordingError(
            f"experiment {experiment.key}: time does not increase after sample {at} ({time[at]!r} s)"
        )
    slots = count_slots(time)
    channels = np.concatenate((experiment.position, experiment.torque), axis=1)
    axes = experiment.position.shape[1]
    if slots.even:
        late = share_of_lateness(slots, channels) * slots.late
        index, step = slots.index, slots.step
    else:
        step = float(np.median(steps))
        index = np.rint((time - time[0]) / step).astype(np.int64)
        late = (time - time[0]) / step - index
    # The end must not hang on a single late stamp.
    exact = np.abs(late) < EVEN_ERROR
    slots_taken = int(index[-1]) + 1
    if exact.all() and slots.even and slots_taken == count:
        return UniformRecord(step, experiment.position, experiment.torque, 0, 1)
    gaps = _gaps(np.unique(index))
    values = _on_grid(index + late, channels, slots_taken, gaps)
    values[index[exact]] = channels[exact]
    for first, last in gaps:
        _fill_gap(values, first, last, gaps, experiment.period_samples)
    longest = int(np.diff(np.unique(index)).max())
    lost = slots_taken - np.unique(index).size
    return UniformRecord(step, values[:, :axes].copy(), values[:, axes:].copy(), lost, longest)


def share_of_lateness(slots: Slots, channels: Float64) -> float:
    """How much of the stamps' lateness the samples show: 1 where they were taken late, 0 where stamped late.

    Parameters
    ----------
    slots
        Of n rows.
    channels
        (n, C) position and torque of all axes.

    Notes
    -----
    A sample taken δ late lies v·δ further along its motion. Sixth differences of runs of seven rows without a
    gap take the motion itself away and leave α·D⁶(v·δ): α by least squares over all channels, each weighted
    by what it leaves, and the belief ``STAMPS_RIGHT`` where the motion does not tell.
    """
    if np.abs(slots.late).max() < EVEN_ERROR:
        return 0.0
    whole = np.diff(slots.index) == 1
    run = np.convolve(whole, np.ones(6), mode="valid") == 6
    near = np.convolve(np.abs(slots.late) <= 1.0, np.ones(7), mode="valid") == 7
    use: Bool = run & near
    information, pull = 1.0 / STAMPS_RIGHT**2, 1.0 / STAMPS_RIGHT**2
    sixth = np.diff(slots.late, 6)[use]
    # A lateness that changes slowly looks like motion: nothing tells it from the stamps' being right.
    if use.sum() < 16 or float(np.mean(sixth**2)) < WHITE * 924.0 * float(np.var(slots.late)):
        return 1.0
    for values in channels.T:
        speed = np.gradient(values)
        x = np.diff(speed * slots.late, 6)[use]
        y = np.diff(values, 6)[use]
        power = float(x @ x)
        if power <= 0.0:
            continue
        for _ in range(2):  # the second time without what stands out: glitches, reversals
            share = float(x @ y) / power
            left = y - share * x
            limit = 6.0 * 1.4826 * float(np.median(np.abs(left)))
            keep = np.abs(left) <= limit if limit > 0 else np.ones(left.size, dtype=np.bool_)
            x, y = x[keep], y[keep]
            power = float(x @ x)
            if power <= 0.0:
                break
        if power <= 0.0:
            continue
        share = float(x @ y) / power
        # Neighbouring sixth differences are correlated: their sum of squared correlations is 3.4.
        variance = 3.4 * float(np.mean((y - share * x) ** 2)) / power
        information += 1.0 / max(variance, 1e-12)
        pull += share / max(variance, 1e-12)
    return float(np.clip(pull / information, 0.0, 1.0))


def _on_grid(at: Float64, values: Float64, count: int, gaps: list[tuple[int, int]]) -> Float64:
    """(count, C) values at whole slots, of (n, C) samples at ``at`` [slots]; long gaps come out as lines."""
    at = np.clip(at, 0.0, count - 1.0)
    for first, last in gaps:
        inside = np.arange(first, last, dtype=float)
        row = int(np.searchsorted(at, first - 0.5))
        ends = values[[max(row - 1, 0), min(row, values.shape[0] - 1)]]
        weight = ((inside - first + 1) / (last - first + 1))[:, None]
        at = np.insert(at, row, inside)
        values = np.insert(values, row, ends[0] + weight * (ends[1] - ends[0]), axis=0)
    knots = np.arange(-5.0, count + 5.0)
    design = scipy.interpolate.BSpline.design_matrix(at, knots, 5)
    size = count + 4
    sixth = [1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0]
    rough = scipy.sparse.diags_array(sixth, offsets=range(7), shape=(max(size - 6, 1), size))
    normal = (design.T @ design + PENALTY * (rough.T @ rough)).todia()
    bands = np.zeros((7, size))
    for k in range(7):
        bands[6 - k, k:] = normal.diagonal(k)
    found = scipy.linalg.solveh_banded(bands, design.T @ values)
    out: Float64 = scipy.interpolate.BSpline.design_matrix(np.arange(float(count)), knots, 5) @ found
    return out


def _gaps(index: Int64) -> list[tuple[int, int]]:
    """First sample and the one after the last of every gap that is too long for a spline."""
    ends = np.flatnonzero(np.diff(index) > LONGEST_GAP)
    return [(int(index[k]) + 1, int(index[k + 1])) for k in ends]


def _fill_gap(values: Float64, first: int, last: int, gaps: list[tuple[int, int]], period: int) -> None:
    """Fill a gap of (n, M) values with what the other periods have there, or with a straight line.

    A spline through nothing swings out. Of a record that repeats the other periods know what was lost; their
    mean is put between the two ends.
    """
    count = values.shape[0]
    at = np.arange(first - 1, last + 1)  # with a sample on either side
    shifts = [k * period for k in range(-(count // period), count // period + 1) if k] if period > 0 else []
    whole = [
        values[at + shift]
        for shift in shifts
        if at[0] + shift >= 0
        and at[-1] + shift < count
        and not any(at[0] + shift < b and a <= at[-1] + shift for a, b in gaps)
    ]
    shape = np.mean(whole, axis=0) if whole else np.zeros((at.size, values.shape[1]))
    mismatch = values[at[[0, -1]]] - shape[[0, -1]]
    weight = np.linspace(0.0, 1.0, at.size)[:, None]
    values[at] = shape + mismatch[0] + weight * (mismatch[1] - mismatch[0])
