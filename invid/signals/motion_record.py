"""One experiment as regression rows: motion, its derivatives and torque in the band that carries both.

Derivatives are taken in the frequency domain with a smooth cut-off (no phase, exact in the pass band);
the cut-off is where the motion falls to ten times the noise that the upper part of its own spectrum
shows. Both sides of the equation of motion then pass the same low-pass filter, so that the filter itself
biases nothing (Gautier's parallel filter).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from invid.numerics.arrays import Bool, Float64
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.timebase import resample_uniformly

NOISE_MARGIN = 5.0
"""Power of the acceleration over its noise that a wider band must bring, all that it adds together: a
trajectory has nulls below its cut-off. Empirical: on eight measured axes 3 and 10 predict worse than 5
(docs/tutorial/real-machines.md)."""
TORQUE_BAND = 1.0
"""Rows reach as far as the torque does (the filter's roll-off adds a quarter). Empirical: on a measured
two-link arm 1.0 to 1.5 give the same parameters within 5 %; from 2 up, where it only vibrates, not."""
ROLL_OFF = (1.0, 1.25)
"""Where the filter of the motion begins to fall and where it has, over its cut-off."""
ROW_ROLL_OFF = (0.0, 2.0)
"""The same of the filter of the rows: one half at the cut-off, and as short in time as a filter can be, so
that what friction does at a reversal does not ring through the rows beside it."""
REACH = 0.5
"""Half the length of the rows' filter, in periods of its cut-off: a fortieth of its response lies beyond."""
TURN = 0.25
"""Periods of the motion's cut-off about a turn within which its filter hides when that was. Empirical:
without it drawn axes miss twice the noise, with more no less; of measured moves it frees a twentieth."""
BLUR = 3.0
"""Deviations of a reading's noise within which it shows no change of direction (statistical)."""
_NOISE_BAND = 0.75
"""The noise is read above this part of the Nyquist band."""
BATCHES = 40
"""Parts of a record of constant velocity whose speeds are compared."""
STEADY = 0.05
"""Part of its speed by which a steady axis may differ from it for a fortieth of the record, beyond noise: as
cogging and a loop that settles do. The means stand for the whole record where friction is smooth so far."""
LEAST_MOVING_SHARE = 0.9
"""Rows that move for less of their filter's length are left out: at standstill friction may be anything."""


@dataclass(frozen=True)
class Band:
    """Usable band of a recording."""

    motion_hz: float
    """Cut-off of position before it is differentiated."""
    rows_hz: Float64
    """(M,) cut-off of both sides of each axis's equation."""
    position_psd: Float64
    """(M,) white noise of position [unit²/Hz], one-sided; of velocity where only that was measured."""
    torque_psd: Float64
    """(M,) white noise of torque [unit²/Hz], one-sided."""
    velocity_only: bool = False

    def noise(self, order: int, cutoff_hz: Float64) -> Float64:
        """(M,) variance that the measured motion's white noise leaves in its derivative below a cut-off."""
        power = 2 * (order - int(self.velocity_only))
        spread: Float64 = (2 * np.pi) ** power * cutoff_hz ** (power + 1) / (power + 1)
        return self.position_psd * spread

    def accelerating(self) -> Float64:
        """(M,) variance that it leaves in the rows' acceleration, what passes beyond the cut-off included."""
        power = 2 * (2 - int(self.velocity_only))
        return self.noise(2, self.rows_hz) * passed_noise(power)


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
    """(n, M) derivative of the torque below the motion's cut-off."""
    torque_bend: Float64
    """(n, M) its second derivative."""
    counts: Float64
    """(M,) step of the encoder; 0 where it is not seen."""
    step: float
    row_step: float
    rest: Float64
    """(M,) speed below which an axis counts as standing, from the velocity noise."""
    reading: Float64
    """(n, M) position as read, of all frequencies."""
    blur: Float64
    """(M,) travel within which noise and counts of the reading hide the direction."""
    still: Bool
    """(n, M) samples at which an axis stands, or so near to a turn that the filter hides when."""
    steady: bool
    band: Band
    keep: Bool
    """(rows,) rows in which every axis moves enough."""
    far: Bool
    """(rows kept, M) rows with no standstill or reversal of the axis within their filter's reach."""
    row_noise: Float64
    """(rows kept, M) variance of the torque row that noise alone leaves (position noise excluded)."""

    def rows(self, columns: Float64) -> Float64:
        """(rows, M, …) of fine columns (n, M, …), each axis in its own band."""
        if self.steady:
            mean: Float64 = columns.mean(axis=0, keepdims=True)
            return mean
        return reduce_rate(columns, self.step, self.band.rows_hz)[self.keep]

    def whole(self) -> Motion:
        """The same with every row, those in which an axis stands or reverses too."""
        every = np.ones(self.keep.size, dtype=np.bool_)
        far, noise = (np.broadcast_to(x, (every.size, self.blur.size)) for x in (True, self.row_noise[:1]))
        return replace(self, keep=every, far=np.array(far), row_noise=np.array(noise))


def derivative(
    values: Float64, step: float, cutoff_hz: float, order: int, roll_off: tuple[float, float] = ROLL_OFF
) -> Float64:
    """Derivative along axis 0, low-passed without phase at ``cutoff_hz`` with a cosine roll-off.

    The record is continued at both ends by its point reflection, which keeps value and slope.
    """
    n = values.shape[0]
    pad = min(n - 1, int(np.ceil(4.0 / (cutoff_hz * step))) + 16)
    # A length with small factors keeps the transform fast.
    extra = min(scipy.fft.next_fast_len(n + 2 * pad, real=True) - n - pad, n - 1)
    ends = 2 * values[:1] - values[pad:0:-1], 2 * values[-1:] - values[-2 : -extra - 2 : -1]
    long = np.concatenate((ends[0], values, ends[1]))
    ramp = np.linspace(long[0], long[-1], long.shape[0])
    frequency = scipy.fft.rfftfreq(long.shape[0], step)
    first, last = roll_off
    roll = np.clip((frequency / cutoff_hz - first) / (last - first), 0.0, 1.0)
    gain = 0.5 * (1 + np.cos(np.pi * roll)) * (2j * np.pi * frequency) ** order
    spectrum = scipy.fft.rfft(long - ramp, axis=0)
    result = scipy.fft.irfft(gain[:, None] * spectrum, long.shape[0], axis=0)
    if order == 0:
        result = result + ramp
    elif order == 1:
        result = result + (long[-1] - long[0]) / ((long.shape[0] - 1) * step)
    filtered: Float64 = result[pad : pad + n]
    return filtered


def passed_noise(power: int) -> float:
    """Variance of noise ∝ f^power behind the filter of the rows, over that behind a sharp cut-off."""
    first, last = ROW_ROLL_OFF
    at = last * (np.arange(1024) + 0.5) / 1024
    gain = 0.5 * (1.0 + np.cos(np.pi * np.clip((at - first) / (last - first), 0.0, 1.0)))
    return (power + 1) * last * float(np.mean(gain**2 * at**power))


def reduce_rate(columns: Float64, step: float, cutoff_hz: Float64) -> Float64:
    """(rows, M, …): axis by axis low-passed, taken at 2.5 times the widest band, ends cut."""
    flat = columns.reshape(columns.shape[0], columns.shape[1], -1)
    parts = [
        flat[:, i]
        if cutoff >= 0.35 / step or not flat[:, i].any()
        else derivative(flat[:, i], step, float(cutoff), 0, ROW_ROLL_OFF)
        for i, cutoff in enumerate(cutoff_hz)
    ]
    filtered = np.stack(parts, axis=1).reshape(columns.shape)
    rows: Float64 = _cut_edges(filtered, step, cutoff_hz)
    return rows


def _cut_edges(values: Any, step: float, cutoff_hz: Float64) -> Any:
    edge = min(int(np.ceil(2.0 / (float(cutoff_hz.min()) * step))), values.shape[0] // 8)
    return values[edge : values.shape[0] - edge : row_spacing(step, cutoff_hz)]


def row_spacing(step: float, cutoff_hz: Float64) -> int:
    """Samples from one row to the next."""
    each = 1.0 / (float(cutoff_hz.max()) * step)
    return 1 if each <= 1 / 0.35 else max(1, int(each / 2.5))


def count_size(position: Float64) -> Float64:
    """(M,) step of the encoder that the samples themselves show; 0 where they lie on no grid.

    The smallest change between samples, where a hundred of all changes are whole multiples of it: noise or
    resampling leaves none that are.
    """
    sizes = np.zeros(position.shape[1])
    for i, column in enumerate(position.T):
        changes = np.abs(np.diff(column))
        changes = changes[changes > 1e-9 * max(float(np.ptp(column)), 1e-300)]
        if changes.size < 100:
            continue
        step = float(changes.min())
        several = changes[changes < 1e4 * step] / step
        if several.size >= 100 and float(np.abs(several - np.round(several)).max()) < 0.05:
            sizes[i] = step
    return sizes


def white_psd(values: Float64, step: float) -> tuple[Float64, Float64, Float64]:
    """Frequencies, one-sided PSD (F, M) and white level (M,) read from the upper part of the band.

    The second difference keeps the trend of a large motion from leaking over the whole spectrum.
    """
    second = np.diff(values, 2, axis=0)
    length = _segment(second.shape[0])
    frequency, power = scipy.signal.welch(second, 1 / step, nperseg=length, axis=0)
    shape = np.abs(1 - np.exp(-2j * np.pi * frequency * step)) ** 4
    power = power / np.maximum(shape, 1e-9)[:, None]
    upper = frequency > _NOISE_BAND * 0.5 / step
    # A median of chi-squared periodogram values lies below their mean; Welch averages enough to ignore it.
    return frequency, power, np.median(power[upper], axis=0)


def _segment(samples: int) -> int:
    """Samples of each of the segments that a spectrum is averaged over."""
    return min(int(min(2048, max(64, samples // 8))), samples)


def _bends(values: Float64, time: Float64) -> Float64:
    """(n − 2, M) second differences at instants that may be uneven; of white noise six times its variance."""
    early, late = np.diff(time)[:-1, None], np.diff(time)[1:, None]
    near = late / (early + late)
    between = near * values[:-2] + (1.0 - near) * values[2:]
    bends: Float64 = np.sqrt(6.0 / (1.0 + near**2 + (1.0 - near) ** 2)) * (between - values[1:-1])
    return bends


def unanswered_level(experiment: Experiment) -> Float64:
    """(M,) white noise of torque [unit²/Hz]: what at the top of the band is not coherent with position.

    A loop answers the noise and the counts of its encoder with torque, more of it the higher the frequency.
    That torque acts, and the axis follows it: it is no error of the record. Samples are taken as they are:
    brought onto an even grid they would have lost noise.
    """
    time = np.asarray(experiment.time)
    step = float(time[-1] - time[0]) / (time.size - 1)
    both = [_bends(np.asarray(values), time) for values in (experiment.torque, experiment.position)]
    length = _segment(both[0].shape[0])
    frequency, power = scipy.signal.csd(both[0].T, both[0].T, 1 / step, nperseg=length)
    upper = frequency > _NOISE_BAND * 0.5 / step
    shape = np.abs(1 - np.exp(-2j * np.pi * frequency[upper] * step)) ** 4
    own = power.real[:, upper].T
    answers, moves = (
        np.array(
            [[scipy.signal.csd(q, x, 1 / step, nperseg=length)[1][upper] for x in part.T] for q in both[1].T]
        )
        for part in both
    )
    averages = max(2 * (both[0].shape[0] // length) - 1, 1)
    count = both[1].shape[1]
    if averages > 2 * count:
        cross, among = answers.transpose(2, 0, 1), moves.transpose(2, 0, 1)
        # Coherence of nothing is one over the averages for each position beside it.
        answered = np.einsum("fqi,fqi->fi", cross.conj(), np.linalg.pinv(among, hermitian=True) @ cross).real
        own = np.maximum(own - answered, 0.0) * averages / (averages - count)
    level: Float64 = np.median(own / shape[:, None], axis=0)
    return level


def find_band(experiments: tuple[Experiment, ...]) -> Band:
    """Cut-offs for all axes, from the longest experiment's own spectra."""
    longest = max(experiments, key=lambda e: e.samples)
    even = resample_uniformly(longest)
    velocity_only = longest.is_integrated_velocity
    motion_of = _forward(even.position, even.step) if velocity_only else even.position
    frequency, power, floor = white_psd(motion_of, even.step)
    _, _, torque_floor = white_psd(even.torque, even.step)
    nyquist = 0.5 / even.step
    cutoffs = []
    for axis in range(power.shape[1]):
        gained = np.cumsum((power[:, axis] - NOISE_MARGIN * floor[axis]) * frequency**4)
        if gained.max() > 0:  # an axis that stands flickers, and says nothing of how fast the others move
            cutoffs.append(float(frequency[int(np.argmax(gained))]))
    # At least eight cycles in the record: below that nothing can be separated from the ends.
    motion = float(np.clip(min(cutoffs, default=0.0), 8.0 / longest.duration, 0.8 * nyquist))
    # Nonlinear terms are evaluated on the motion up to its cut-off and compared below half of that, where the
    # harmonics that the cut-off takes away are missing least.
    carried_bands = 0.6 * motion if motion >= 0.6 * nyquist else 0.5 * motion
    # Above what drives it, an axis shows its disturbances: regressing on that motion shrinks every estimate.
    torque_limits = TORQUE_BAND * _torque_bandwidth(
        [e for e in experiments if e.kind is longest.kind], torque_floor
    )
    rows = np.clip(torque_limits, 8.0 / longest.duration, carried_bands)
    return Band(motion, rows, floor, unanswered_level(longest), velocity_only)


def motions_of(recording: Recording) -> list[Motion]:
    """Every experiment as rows, in one band."""
    band = find_band(recording.experiments)
    return [prepare_rows(e, band) for e in recording.experiments]


def _forward(position: Float64, step: float) -> Float64:
    """The forward difference, which gives back the velocity that was integrated, exactly."""
    changes = np.diff(position, axis=0)
    return np.append(changes, changes[-1:], axis=0) / step


def _torque_bandwidth(experiments: list[Experiment], floor: Float64) -> Float64:
    """(M,) frequency below which all but a thousandth of the torque's power above its noise lies [Hz]."""
    pieces = []
    for experiment in experiments:
        even = resample_uniformly(experiment)
        frequency, power = scipy.signal.periodogram(
            even.torque, 1 / even.step, window="hann", detrend="linear", axis=0
        )
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


def prepare_rows(experiment: Experiment, band: Band) -> Motion:
    """The experiment as regression rows; as one row of means where its velocity is one and the same."""
    if experiment.kind is Kind.CONSTANT_VELOCITY:
        stretch = steady_stretch(experiment)
        if stretch is not None:
            return _constant_velocity_row(experiment, stretch, band)
    even = resample_uniformly(experiment)
    step, cutoff = even.step, band.motion_hz
    position, velocity, acceleration = (derivative(even.position, step, cutoff, k) for k in range(3))
    counts = count_size(even.position)
    if experiment.is_integrated_velocity:
        measured = _forward(even.position, step)
        velocity, acceleration = (derivative(measured, step, cutoff, k) for k in range(2))
        counts = np.zeros_like(counts)
    torque_rate, torque_bend = (derivative(even.torque, step, cutoff, k) for k in (1, 2))
    # Where counts come more slowly than the cut-off the derivative shows the counts, not the motion.
    noise = band.noise(1, np.full(position.shape[1], cutoff))
    rest = np.maximum(3.0 * np.sqrt(noise), counts * cutoff)
    unread = np.sqrt(band.noise(0, np.full(position.shape[1], 0.5 / step)))
    inner = _without_jumps(acceleration, step, cutoff)
    position, velocity, acceleration = position[inner], velocity[inner], acceleration[inner]
    moving = np.abs(velocity) > rest
    keep: Bool = np.all(reduce_rate(moving.astype(float), step, band.rows_hz) > LEAST_MOVING_SHARE, axis=1)
    stands = ~moving | (np.sign(velocity) != np.sign(np.roll(velocity, 1, axis=0)))
    far: Bool = ~_cut_edges(_beside(stands, REACH / (band.rows_hz * step)), step, band.rows_hz)[keep]
    row_noise = np.broadcast_to(
        band.torque_psd * band.rows_hz * passed_noise(0), (int(keep.sum()), position.shape[1])
    )
    stride = row_spacing(step, band.rows_hz)
    return Motion(
        key=experiment.key,
        role=experiment.role,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=even.torque[inner],
        torque_rate=torque_rate[inner],
        torque_bend=torque_bend[inner],
        counts=counts,
        step=step,
        row_step=stride * step,
        rest=rest,
        reading=np.asarray(even.position)[inner],
        blur=np.maximum(np.maximum(BLUR * unread, counts), 1e-300),
        still=_beside(stands, np.full(counts.size, TURN / (cutoff * step))),
        steady=False,
        band=band,
        keep=keep,
        far=far,
        row_noise=np.array(row_noise),
    )


def _beside(at: Bool, reach: Float64) -> Bool:
    """(n, M) samples no farther from one of those given than the reach of its axis (M,)."""
    sizes = 2 * np.maximum(1, np.round(reach)).astype(int) + 1
    return np.stack([scipy.ndimage.maximum_filter1d(a, s) for a, s in zip(at.T, sizes, strict=True)], axis=1)


def _without_jumps(acceleration: Float64, step: float, cutoff_hz: float) -> slice:
    """The samples without the ends of a record that begins or ends while it accelerates.

    The second derivative of its point reflection jumps there by twice the acceleration, and the filter of the
    rows would carry that inwards. A tenth of the rms is the most that is let pass: empirical, on drawn axes.
    """
    count = acceleration.shape[0]
    end = min(int(np.ceil(4.0 / (cutoff_hz * step))), count // 8)
    half = max(end // 2, 1)
    ends = (acceleration[at : at + end].mean(axis=0) for at in (half, count - end - half))
    most = 0.1 * np.sqrt(np.mean(acceleration**2, axis=0))
    first, last = (end if bool((np.abs(a) > most).any()) else 0 for a in ends)
    return slice(first, count - last)


LEAST_SAMPLES = 8
"""Samples from which on a mean has a scatter of its own."""


def steady_stretch(experiment: Experiment) -> slice | None:
    """Samples between run-in and run-out in which every axis keeps its speed; ``None`` if fewer than half do.

    What reverses or changes its speed within the record is a motion as any other, whatever its kind is
    called: of means over both directions friction is gone.
    """
    time, position = experiment.time, experiment.position
    count = min(BATCHES, (time.size - 1) // 4)
    if count < 4:
        return slice(0, time.size)
    edges = np.linspace(0, time.size - 1, count + 1).astype(int)
    duration = np.diff(time[edges])[:, None]
    speed = np.diff(position[edges], axis=0) / duration
    usual = np.median(speed, axis=0)
    # White noise of the velocity, from its changes between samples; counts of an encoder change it by steps.
    velocity = np.diff(position, axis=0) / np.diff(time)[:, None]
    scatter = np.median(np.abs(np.diff(velocity, axis=0)), axis=0) / (0.6745 * np.sqrt(2.0))
    changes = np.abs(np.diff(position, axis=0))
    counts = np.array([c[c > 0].min() if (c > 0).any() else 0.0 for c in changes.T])
    noise = 4.0 * scatter / np.sqrt(np.diff(edges))[:, None] + 2.0 * counts / duration
    even = np.all(np.abs(speed - usual) <= STEADY * np.abs(usual) + noise, axis=1)
    ends = np.flatnonzero(np.diff(np.concatenate(([0], even.astype(np.int8), [0])))).reshape(-1, 2)
    if ends.size == 0:
        return None
    first, last = ends[np.argmax(ends[:, 1] - ends[:, 0])]
    if last - first < count // 2:
        return None
    # Of what runs in or out within a batch its mean speed shows little, and its torque much.
    start, stop = int(edges[first + 1]), int(edges[last - 1]) + 1
    return slice(start, stop) if stop - start >= LEAST_SAMPLES else None


def _constant_velocity_row(experiment: Experiment, stretch: slice, band: Band) -> Motion:
    """Constant velocity: one row, the means; the noise of a mean from the spread of batch means."""
    time, position, torque = (
        part[stretch] for part in (experiment.time, experiment.position, experiment.torque)
    )
    slopes = np.diff(position, axis=0) / np.diff(time)[:, None]
    velocity = np.zeros_like(position) + slopes.mean(axis=0)
    batches = np.array([b.mean(axis=0) for b in np.array_split(torque, min(8, len(torque) // 2))])
    variance = batches.var(axis=0, ddof=1) / batches.shape[0]
    return Motion(
        key=experiment.key,
        role=experiment.role,
        position=np.asarray(position),
        velocity=velocity,
        acceleration=np.zeros_like(velocity),
        torque=np.asarray(torque),
        torque_rate=np.zeros_like(velocity),
        torque_bend=np.zeros_like(velocity),
        counts=np.zeros(position.shape[1]),
        step=float(np.median(np.diff(time))),
        row_step=float(time[-1] - time[0]),
        rest=np.zeros(position.shape[1]),
        reading=np.asarray(position),
        blur=np.full(position.shape[1], 1e-300),
        still=np.zeros(position.shape, dtype=np.bool_),
        steady=True,
        band=band,
        keep=np.ones(1, dtype=np.bool_),
        far=np.ones((1, position.shape[1]), dtype=np.bool_),
        row_noise=variance[None, :],
    )
