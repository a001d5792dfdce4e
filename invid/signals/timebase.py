"""Samples at the true SYNC instants, with jitter and losses, resampled onto a uniform grid.

Spectra want equidistant samples. Where the instants are even to a thousandth of a sample nothing is
touched. Otherwise every channel is interpolated by a quintic spline through the true instants; its
error for a signal at a fifth of the sample rate is below 1e-3 of the amplitude and falls with the
sixth power of frequency, so motion of a robot axis at 1 kHz is carried to machine precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from invid.errors import RecordingError
from invid.numerics.arrays import Float64, Int64
from invid.recording.model import Experiment

EVEN_ERROR = 1e-3
"""Timing error in samples below which instants count as even: at a tenth of the sample rate it moves
a sample by 6e-4 of the amplitude, incoherently, so 1e-5 of a line of a thousand samples or more."""

LONGEST_GAP = 3
"""Steps between two samples up to which the spline is trusted: with two samples lost it is off by 0.4 % of
the amplitude at a tenth of the sampling rate and by a fifth at a fifth, with five by 13 % and three times."""


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
    typical = float(np.median(steps))
    # A gap of 1.5 steps or more is at least one sample that never came.
    advance = np.maximum(np.round(steps / typical), 1.0)
    index = np.concatenate(([0.0], np.cumsum(advance)))
    slope, start = np.polyfit(index - index[-1] / 2, time - time[0], 1)
    step = float(slope)
    origin = float(time[0] + start - slope * index[-1] / 2)
    error = (time - origin) / step - index
    lost = int(index[-1]) + 1 - count
    if lost == 0 and np.abs(error).max() < EVEN_ERROR:
        return UniformRecord(step, experiment.position, experiment.torque, 0, 1)
    grid = np.clip(origin + step * np.arange(int(index[-1]) + 1), time[0], time[-1])

    gaps = _gaps(index.astype(int))

    def resample(values: Float64) -> Float64:
        result: Float64 = scipy.interpolate.make_interp_spline(time, values, k=5)(grid)
        for first, last in gaps:
            _fill_gap(result, first, last, gaps, experiment.period_samples)
        return result

    return UniformRecord(
        step,
        resample(experiment.position),
        resample(experiment.torque),
        lost,
        int(advance.max()),
    )


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
