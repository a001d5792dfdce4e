"""One experiment made ready for regression: motion, its derivatives and torque in the band that carries both.

Derivatives are taken in the frequency domain with a smooth cut-off (no phase, exact in the pass band);
the cut-off is where the motion falls to ten times the noise that the upper part of its own spectrum
shows. Both sides of the equation of motion then pass the same low-pass filter, so that the filter itself
biases nothing (Gautier's parallel filter).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft
from scipy.ndimage import minimum_filter1d
from scipy.signal import periodogram, welch

from invid.arrays import Bool, Float64
from invid.recording.model import Experiment, Kind, Role
from invid.timebase import uniform

NOISE_MARGIN = 10.0
"""Power of the motion over its noise at the cut-off: 10 dB, below which a derivative is mostly noise."""
TORQUE_BAND = 1.0
"""Rows reach as far as the torque does (the filter's roll-off adds a quarter). Empirical: on a measured
two-link arm 1.0 to 1.5 give the same parameters within 5 %; from 2 up, where it only vibrates, not."""
_UPPER = 0.75
"""The noise is read above this part of the Nyquist band."""
MOVING = 0.9
"""Rows that move for less of their filter's length are left out: at standstill friction may be anything."""


@dataclass(frozen=True)
class Band:
    """What one recording can carry."""

    motion_hz: float
    """Cut-off of position before it is differentiated."""
    rows_hz: Float64
    """(M,) cut-off of both sides of each axis's equation."""
    position_psd: Float64
    """(M,) white noise of position [unit²/Hz], one-sided."""
    torque_psd: Float64
    """(M,) white noise of torque [unit²/Hz], one-sided."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Fine signals (n, M) of one experiment and the way from fine columns to rows of the regression."""

    key: str
    role: Role
    position: Float64
    velocity: Float64
    acceleration: Float64
    torque: Float64
    torque_rate: Float64
    """(n, M) derivative of the torque below the rows' cut-off."""
    step: float
    row_step: float
    rest: Float64
    """(M,) speed below which an axis counts as standing, from the velocity noise."""
    steady: bool
    band: Band
    keep: Bool
    """(rows,) rows in which every axis moves enough."""
    far: Bool
    """(rows kept,) rows with no standstill or reversal of any axis within their filter's reach."""
    row_noise: Float64
    """(rows kept, M) variance of the torque row that noise alone leaves (position noise excluded)."""

    def rows(self, columns: Float64) -> Float64:
        """(rows, M, …) of fine columns (n, M, …), each axis in its own band."""
        if self.steady:
            mean: Float64 = columns.mean(axis=0, keepdims=True)
            return mean
        return reduced(columns, self.step, self.band.rows_hz)[self.keep]


def derivative(values: Float64, step: float, cutoff_hz: float, order: int) -> Float64:
    """Derivative along axis 0, low-passed without phase at ``cutoff_hz`` (cosine roll-off over a quarter).

    The record is continued at both ends by its point reflection, which keeps value and slope.
    """
    n = values.shape[0]
    pad = min(n - 1, int(np.ceil(4.0 / (cutoff_hz * step))) + 16)
    # A length with small factors keeps the transform fast.
    extra = min(fft.next_fast_len(n + 2 * pad, real=True) - n - pad, n - 1)
    head = 2 * values[:1] - values[pad:0:-1]
    tail = 2 * values[-1:] - values[-2 : -extra - 2 : -1]
    long = np.concatenate((head, values, tail))
    ramp = np.linspace(long[0], long[-1], long.shape[0])
    frequency = fft.rfftfreq(long.shape[0], step)
    roll = np.clip((frequency / cutoff_hz - 1.0) / 0.25, 0.0, 1.0)
    gain = 0.5 * (1 + np.cos(np.pi * roll)) * (2j * np.pi * frequency) ** order
    spectrum = fft.rfft(long - ramp, axis=0)
    result = fft.irfft(gain[:, None] * spectrum, long.shape[0], axis=0)
    if order == 0:
        result = result + ramp
    elif order == 1:
        result = result + (long[-1] - long[0]) / ((long.shape[0] - 1) * step)
    filtered: Float64 = result[pad : pad + n]
    return filtered


def reduced(columns: Float64, step: float, cutoff_hz: Float64) -> Float64:
    """(rows, M, …): axis by axis low-passed, taken at 2.5 times the widest band, ends cut."""
    flat = columns.reshape(columns.shape[0], columns.shape[1], -1)
    parts = [
        flat[:, i]
        if cutoff >= 0.35 / step or not flat[:, i].any()
        else derivative(flat[:, i], step, float(cutoff), 0)
        for i, cutoff in enumerate(cutoff_hz)
    ]
    filtered = np.stack(parts, axis=1).reshape(columns.shape)
    rows: Float64 = _taken(filtered, step, cutoff_hz)
    return rows


def _taken(values: Any, step: float, cutoff_hz: Float64) -> Any:
    edge = min(int(np.ceil(2.0 / (float(cutoff_hz.min()) * step))), values.shape[0] // 8)
    return values[edge : values.shape[0] - edge : spacing(step, cutoff_hz)]


def spacing(step: float, cutoff_hz: Float64) -> int:
    """Samples from one row to the next."""
    widest = float(cutoff_hz.max())
    return 1 if widest >= 0.35 / step else max(1, int(1.0 / (2.5 * widest * step)))


def white_psd(values: Float64, step: float) -> tuple[Float64, Float64, Float64]:
    """Frequencies, one-sided PSD (F, M) and white level (M,) read from the upper part of the band.

    The second difference keeps the trend of a large motion from leaking over the whole spectrum.
    """
    second = np.diff(values, 2, axis=0)
    length = int(min(2048, max(64, second.shape[0] // 8)))
    length = min(length, second.shape[0])
    frequency, power = welch(second, 1 / step, nperseg=length, axis=0)
    shape = np.abs(1 - np.exp(-2j * np.pi * frequency * step)) ** 4
    power = power / np.maximum(shape, 1e-9)[:, None]
    upper = frequency > _UPPER * 0.5 / step
    # A median of chi-squared periodogram values lies below their mean; Welch averages enough to ignore it.
    return frequency, power, np.median(power[upper], axis=0)


def find_band(experiments: tuple[Experiment, ...]) -> Band:
    """Cut-offs that all axes can carry, from the longest experiment's own spectra."""
    longest = max(experiments, key=lambda e: e.samples)
    even = uniform(longest)
    frequency, power, floor = white_psd(even.position, even.step)
    _, _, torque_floor = white_psd(even.torque, even.step)
    nyquist = 0.5 / even.step
    cutoffs = []
    for axis in range(power.shape[1]):
        low = np.flatnonzero(power[1:, axis] < NOISE_MARGIN * floor[axis]) + 1
        cutoffs.append(float(frequency[low[0]]) if low.size else 0.8 * nyquist)
    # At least eight cycles in the record: below that nothing can be separated from the ends.
    motion = float(np.clip(min(cutoffs), 8.0 / longest.duration, 0.8 * nyquist))
    # Nonlinear terms are evaluated on the motion up to its cut-off and compared below half of that, where the
    # harmonics that the cut-off takes away are missing least.
    carried = 0.6 * motion if motion >= 0.6 * nyquist else 0.5 * motion
    # Above what drives it, an axis shows its disturbances: regressing on that motion shrinks every estimate.
    driven = TORQUE_BAND * _torque_edge([e for e in experiments if e.kind is longest.kind], torque_floor)
    return Band(motion, np.clip(driven, 8.0 / longest.duration, carried), floor, torque_floor)


def _torque_edge(experiments: list[Experiment], floor: Float64) -> Float64:
    """(M,) frequency below which all but a thousandth of the torque's power above its noise lies [Hz]."""
    pieces = []
    for experiment in experiments:
        even = uniform(experiment)
        frequency, power = periodogram(even.torque, 1 / even.step, window="hann", detrend="linear", axis=0)
        clean = np.maximum(power - floor, 0.0) * frequency[1] * experiment.duration
        pieces.append((np.repeat(frequency[:, None], clean.shape[1], axis=1), clean))
    edges = []
    for axis in range(floor.size):
        frequency = np.concatenate([f[:, axis] for f, _ in pieces])
        order = np.argsort(frequency)
        share = np.cumsum(np.concatenate([p[:, axis] for _, p in pieces])[order])
        if share[-1] <= 0:
            edges.append(np.inf)
            continue
        edges.append(float(frequency[order][np.searchsorted(share, 0.999 * share[-1])]))
    return np.array(edges)


def prepare(experiment: Experiment, band: Band) -> Motion:
    """The experiment as regression rows."""
    velocity_only = experiment.attributes.get("position_source") == "integrated_velocity"
    steady = experiment.kind is Kind.CONSTANT_VELOCITY
    if steady:
        return _steady(experiment, band)
    even = uniform(experiment)
    step, cutoff = even.step, band.motion_hz
    position = derivative(even.position, step, cutoff, 0)
    velocity = derivative(even.position, step, cutoff, 1)
    acceleration = derivative(even.position, step, cutoff, 2)
    if velocity_only:
        # The forward difference gives back the velocity that was integrated, exactly.
        measured = np.diff(even.position, axis=0, append=even.position[-1:]) / step
        measured[-1] = measured[-2]
        velocity = derivative(measured, step, cutoff, 0)
        acceleration = derivative(measured, step, cutoff, 1)
    noise = band.position_psd * (2 * np.pi) ** 2 * cutoff**3 / 3
    rest = 3.0 * np.sqrt(noise)
    moving = (np.abs(velocity) > rest).astype(float)
    share = reduced(moving, step, band.rows_hz)
    keep: Bool = np.all(share > MOVING, axis=1)
    same = np.sign(velocity) == np.sign(np.roll(velocity, 1, axis=0))
    reach = 2 * max(1, round(0.5 / (float(band.rows_hz.min()) * step))) + 1
    steadily = minimum_filter1d(np.all(same & (moving > 0), axis=1).astype(np.int8), reach)
    far: Bool = (_taken(steadily, step, band.rows_hz) > 0)[keep]
    row_noise = np.broadcast_to(band.torque_psd * band.rows_hz, (int(keep.sum()), position.shape[1]))
    every = spacing(step, band.rows_hz)
    return Motion(
        key=experiment.key,
        role=experiment.role,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=even.torque,
        torque_rate=derivative(even.torque, step, float(band.rows_hz.max()), 1),
        step=step,
        row_step=every * step,
        rest=rest,
        steady=False,
        band=band,
        keep=keep,
        far=far,
        row_noise=np.array(row_noise),
    )


def _steady(experiment: Experiment, band: Band) -> Motion:
    """Constant velocity: one row, the means; the noise of a mean from the spread of batch means."""
    time, position, torque = experiment.time, experiment.position, experiment.torque
    slope = np.diff(position, axis=0) / np.diff(time)[:, None]
    velocity = np.broadcast_to(slope.mean(axis=0), position.shape).copy()
    batches = np.array([b.mean(axis=0) for b in np.array_split(torque, 8)])
    variance = batches.var(axis=0, ddof=1) / batches.shape[0]
    return Motion(
        key=experiment.key,
        role=experiment.role,
        position=np.asarray(position),
        velocity=velocity,
        acceleration=np.zeros_like(velocity),
        torque=np.asarray(torque),
        torque_rate=np.zeros_like(velocity),
        step=float(np.median(np.diff(time))),
        row_step=float(time[-1] - time[0]),
        rest=np.zeros(position.shape[1]),
        steady=True,
        band=band,
        keep=np.ones(1, dtype=np.bool_),
        far=np.ones(1, dtype=np.bool_),
        row_noise=variance[None, :],
    )
