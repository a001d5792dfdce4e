"""One experiment whole, on lines of its span, with the sensors' noise and the motors' motion over time.

Whatever moved the axes, the transform over a span T of a plant's motion obeys

    Z θ = τ + V(α + jωβ)·2/T,

where α, β belong to the record's two ends. Transforms are integrals over the span, X(ω) = 2/T ∫ x e^{−jωt}
dt, by
the trapezoidal rule; of positions the parabola that has their jumps of value and slope from end to start is
transformed exactly, since the rule errs by (ωh)²/12 of a jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from invid.numerics.arrays import Complex128, Float64, Int64
from invid.recording.model import Experiment, Role
from invid.signals.band import elastic_band, excited_band, sparse_lines
from invid.signals.demand import command_within
from invid.signals.timebase import resample_uniformly

DENSE = 1.3
"""Lines up to this multiple of the highest excited one are all used, beyond it every fifth of a period's up
to ``REACH`` times: they show what friction and play make there (empirical, whole cells)."""
REACH, SPARSE = 2.5, 5
WIDE, LAWFUL = 5.0, 10.0
"""Multiples of the highest excited line up to which readings tell the motion within a record, and up to which
that of a motor that sticks is made to agree with laws: it has corners beyond (empirical, strong friction in
chirps and production motion: at five a hundredth to a twentieth of it is left over)."""
SLOW, STICKS = 0.02, 0.08
"""Speed over its rms, and the share of time below it from which a motor sticks: five times that of a normal
distribution."""
FINENESS = 160
"""Points of the grid of motion in a period of the highest excited line: reversals of friction and the edges
of a gap are read to a few thousandths of it."""
SINGLE = 1e-12
"""Least noise of a torque over the power of its largest line: its rounding in single precision."""
QUIET_BAND = (0.05, 0.45)
"""Share of the sampling rate between which lines show the sensors alone: motion falls off with the second
power of frequency (or of the lines above ``WIDE`` where the band reaches higher)."""
SLOWEST_COUNTS = 50.0
"""Most by which the rounding of a slow axis gathers at low frequencies."""
MOST_LINES, MOST_POINTS = 4000, 1_000_000
"""Most lines of a record, of longer ones every 2ᵏ-th is used, which loses their resolution and keeps their
noise; and most points of the grid of motion, where the samples themselves are not more."""
LONG, SHARED = 100_000, 64
"""Samples from which a span without a period is a multiple of ``SHARED`` samples, so that its parts can be
added up first where only every 2ᵏ-th line is asked for."""


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """Motor motion without the encoder's noise on an even grid over the span, both ends included.

    ``position``, ``velocity`` (k + 1, M); ``step`` [s].
    """

    position: Float64
    velocity: Float64
    step: float

    @cached_property
    def acceleration(self) -> Float64:
        """(k + 1, M) derivative of the velocity."""
        return np.asarray(np.gradient(self.velocity, self.step, axis=0), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Record:
    """One experiment on F lines, and on A further ones up to where motion is known.

    Attributes
    ----------
    wide, used
        (A,) all lines [rad/s] from 0 Hz, and (F,) which of them the likelihood uses.
    position, torque
        (A, M) amplitudes.
    position_noise, torque_noise
        (M,) power of the sensors' noise on a line.
    span, step, start
        T, the sampling interval and the time at which the span begins [s].
    hold
        (M,) torque per position by which axes are held; NaN where a drive holds by itself.
    hold_damping
        (M,) torque per velocity of the hold, read from the record; NaN as above.
    driven
        (M,) whether the axis is excited.
    jump
        (M,) change of position from the record's start to its end.
    torque_wave
        (n + 1, M) torque as sampled over the span.
    excited
        Numbers of the lines that are said to be excited.
    periods
        Number of periods in the span; 0 where it has none.
    top_hz
        Highest excited frequency.
    origin
        Time at which the recording begins [s].
    command
        (A, M) amplitudes of the command within the torque, NaN on axes of which it is not logged.
    late
        Time by which the torque is recorded after it acted, where the command tells [s].
    is_hold_sampled
        Whether the holds are computed once a sample and act with the command.
    """

    key: str
    role: Role
    wide: Float64
    used: Int64
    position: Complex128
    torque: Complex128
    position_noise: Float64
    torque_noise: Float64
    span: float
    step: float
    start: float
    hold: Float64
    hold_damping: Float64
    driven: np.ndarray
    jump: Float64
    motion: SmoothMotion
    torque_wave: Float64
    excited: Int64
    periods: int
    top_hz: float
    origin: float = 0.0
    command: Complex128 | None = None
    late: float = 0.0
    is_hold_sampled: bool = False

    @cached_property
    def omega(self) -> Float64:
        """(F,) lines of the likelihood [rad/s]."""
        out: Float64 = self.wide[self.used]
        return out

    @cached_property
    def weight(self) -> Float64:
        """(F,) one half for the mean, which is real, one elsewhere."""
        return line_weight(self.omega)

    @cached_property
    def carrying(self) -> Int64:
        """Numbers of the lines that the excitation drives: as stated, else those of the period on which a
        torque stands out of its noise."""
        if self.excited.size:
            stated = np.unique(self.excited)
            return np.asarray(stated[(stated > 0) & (stated < self.wide.size)])
        number = np.arange(self.wide.size)
        number = number[(number > 0) & (number % max(self.periods, 1) == 0)]
        sparse = sparse_lines(self.torque[number]) if self.periods > 1 else None
        if sparse is not None:
            return np.asarray(number[sparse])
        power = np.abs(self.torque[number]) ** 2
        # |X|²/σ² is exponential for noise: exceeded once in 1e4 lines; a thousandth of the strongest line's
        # power is no excitation either, but distortion or leakage.
        limit = np.maximum(self.torque_noise * np.log(1e4), 1e-4 * power.max(axis=0, initial=0.0))
        return np.asarray(number[(power > limit).any(axis=1)])

    @cached_property
    def closed_position(self) -> Complex128:
        """(A, M) position of a record that repeats without its drift.

        A free axis coasts, and the straight line through the means of its periods leaks onto every line.
        """
        if self.periods < 2:
            return self.position
        means = self.motion.position[:-1].reshape(self.periods, -1, self.hold.size).mean(axis=1)
        order = np.arange(self.periods) - (self.periods - 1) / 2.0
        drift = self.periods * (order @ means) / (order @ order)
        return np.asarray(self.position - parabola(self.wide, self.span, drift, np.zeros(drift.size)))

    def with_hold(self, axis: int, stiffness: float, damping: float) -> Record:
        """The record with the hold of an axis."""
        hold, damped = self.hold.copy(), self.hold_damping.copy()
        hold[axis], damped[axis] = stiffness, damping
        return replace(self, hold=hold, hold_damping=damped)

    def velocity(self, axis: int, lines: Int64) -> Complex128:
        """(L,) velocity of a motor on lines, its ends included."""
        moving = 1j * self.wide[lines] * self.position[lines, axis]
        return np.asarray(moving + 2.0 / self.span * self.jump[axis])

    def stride(self, most: int) -> int:
        """Most instants of the grid of motion, up to ``most``, that divide a period, or the span without
        one."""
        count = (self.motion.position.shape[0] - 1) // max(self.periods, 1)
        return max(k for k in range(1, most + 1) if count % k == 0)

    def tells_command(self, axis: int) -> bool:
        """Return whether the command of an axis is logged apart from its hold."""
        return self.command is not None and bool(np.isfinite(self.command[0, axis]))

    def lines(self, series: Float64) -> Complex128:
        """(F, …) transform of ``series`` (k + 1, …) on the grid of motion."""
        return transform(series, self.used, self.periods or self.thinning)

    @cached_property
    def thinning(self) -> int:
        """Every so many lines one is used."""
        return int(np.gcd(np.gcd.reduce(self.used), SHARED))

    def wide_lines(self, series: Float64) -> Complex128:
        """(A, …) transform on all lines up to where motion is known."""
        return transform(series, np.arange(self.wide.size), 0)


def parabola(omega: Float64, span: float, jump: Float64, bend: Float64) -> Complex128:
    """(A, M) lines of the parabola from 0 with these jumps (M,) of value and slope over a span [s]."""
    turning = np.where(omega > 0, omega, 1.0)[:, None]
    out: Complex128 = (2.0 / span) * (1j * jump / turning + bend / turning**2)
    square = bend / (2.0 * span)
    out[0] = (2.0 / span) * ((jump / span - square * span) * span**2 / 2.0 + square * span**3 / 3.0)
    return out


def line_weight(omega: Float64) -> Float64:
    """(F,) weight of lines: one half for the mean, which is real, one elsewhere."""
    return np.where(omega == 0.0, 0.5, 1.0)


def transform(series: Float64, lines: Int64, periods: int = 0) -> Complex128:
    """(F, …) amplitudes 2/T ∫ x e^{−jωt} dt of ``series`` (k + 1, …) on ``lines`` (F,), trapezoidal rule.

    Where all lines are multiples of ``periods``, the periods are added up first.
    """
    closed = series[:-1].copy()
    closed[0] = 0.5 * (series[0] + series[-1])
    count = closed.shape[0]
    if periods > 1 and count % periods == 0 and not np.any(lines % periods):
        closed = closed.reshape(periods, count // periods, *closed.shape[1:]).sum(axis=0)
        lines = lines // periods
    out: Complex128 = np.fft.rfft(closed, axis=0)[lines] * (2.0 / count)
    return out


def make_record(experiment: Experiment, resolution: Float64 | None, top_hz: float | None = None) -> Record:
    """The record of an experiment whose samples are sound.

    Parameters
    ----------
    resolution
        (M,) counts of the encoders [rad or m]; read from the samples where not given.
    top_hz
        Highest frequency of interest: that which is excited where the experiment says so, else the least of
        where the torque stands above its noise and twice the highest resonance.
    """
    even = resample_uniformly(experiment)
    step, position, torque = even.step, even.position, even.torque
    periods, count = _span(experiment, even.samples)
    if count == position.shape[0]:  # the span's last instant is one sample after the record's last
        position = np.concatenate((position, 3 * position[-1:] - 3 * position[-2:-1] + position[-3:-2]))
        torque = np.concatenate((torque, 2 * torque[-1:] - torque[-2:-1]))
    position, torque = position[-count - 1 :], torque[-count - 1 :]
    span = count * step
    frequency: Float64 = np.fft.rfftfreq(count, step).astype(np.float64)
    spectrum = transform(torque, np.arange(frequency.size))
    excited = max(excited_band(experiment, frequency, spectrum), top_hz or 0.0)
    excited_lines = np.round(experiment.frequencies_hz * span).astype(np.int64)
    quiet = _quiet_lines(frequency, step, excited, (periods, excited_lines))
    torque_noise = np.maximum(_level(spectrum[quiet]), SINGLE * (np.abs(spectrum) ** 2).max(axis=0))
    counts = _counts(position) if resolution is None else np.asarray(resolution, dtype=float)
    rounding = _rounding(position, step, counts) * 4.0 / count
    motion = _smooth(position, step, excited, rounding)
    jump, bend = (w[-1] - w[0] for w in (motion.position, motion.velocity))
    time = np.arange(count + 1)[:, None] * step
    square = bend / (2.0 * span)
    ramp = jump / span - square * span
    rest = transform(position - ramp * time - square * time**2, np.arange(frequency.size))
    driven = _driven(experiment, position.shape[1])
    stated = bool(experiment.frequencies_hz.size) or periods > 1
    top = top_hz or (excited if stated else elastic_band(frequency, rest, spectrum, driven, excited))
    reach = LAWFUL if _sticks(motion.velocity[:, driven]) else WIDE
    wide = np.arange(int(np.searchsorted(frequency, min(reach * top, 0.4 / step), side="right")))
    omega: Float64 = 2 * np.pi * frequency[wide]
    lines = rest[wide] + parabola(omega, span, jump, bend)
    used = _used_lines(frequency[wide], top, periods)
    rounded = _rounding_seen(motion.position[:: round(step / motion.step)], counts, used)
    position_noise = np.maximum(_level(rest[quiet]), rounded)
    if even.lost and periods > 1:  # what was interpolated repeats with no period
        rough = np.flatnonzero((frequency <= DENSE * top) & (np.arange(frequency.size) % periods != 0))
        position_noise = np.maximum(position_noise, _level(rest[rough]))
        torque_noise = np.maximum(torque_noise, _level(spectrum[rough]))
    hold = np.asarray(experiment.hold_gain, dtype=float)
    # Between the lines of a period stands what it took to reach it, without a command of its own.
    between = (wide % periods != 0) if periods > 1 else np.zeros(wide.size, dtype=bool)
    free = between[:, None] | ~driven
    demand = experiment.torque_demand
    command, late = None, 0
    if demand is not None and demand.shape[0] == even.samples == experiment.samples:
        held = demand[-count - 1 :] if count < even.samples else np.concatenate((demand, demand[-1:]))
        ends = (held[-1] - held[0]) / count  # held over the sample it needs no trapezoid's correction
        on_lines = transform(held, np.arange(wide.size)) - ends
        command, late = command_within((omega, lines, spectrum[wide]), on_lines, step)
        command[:, (hold == 0.0) | ~np.any(demand != 0.0, axis=0)] = np.nan
    return Record(
        key=experiment.key,
        role=experiment.role,
        wide=omega,
        used=used,
        position=lines,
        torque=spectrum[wide],
        position_noise=position_noise,
        torque_noise=torque_noise,
        span=span,
        step=step,
        start=float(experiment.time[0]) + step * (even.samples - count - int(count < even.samples)),
        hold=hold,
        hold_damping=_hold_damping((omega, lines, spectrum[wide]), hold, free, 2.0 / span * jump),
        driven=driven,
        jump=jump,
        motion=motion,
        torque_wave=torque,
        excited=excited_lines,
        periods=periods,
        top_hz=top,
        command=command,
        late=late * step,
        is_hold_sampled=experiment.attributes.get("hold_by") == "master",
    )


def _span(experiment: Experiment, samples: int) -> tuple[int, int]:
    """Periods in the span, and its number of samples: whole periods, else nearly all, of a number that is
    transformed fast (with a large prime factor it takes ten times as long)."""
    period = experiment.period_samples
    periods = samples // period if 0 < period <= samples else 0
    if periods:
        return periods, periods * period
    shared = SHARED if samples > LONG else 1
    return 0, shared * scipy.fft.prev_fast_len((samples - 1) // shared)


def _driven(experiment: Experiment, motors: int) -> np.ndarray:
    axis = experiment.excited_axis
    return np.arange(motors) == axis if 0 <= axis < motors else np.ones(motors, dtype=bool)


def _sticks(velocity: Float64) -> bool:
    """Whether a motor of (k, M) stands again and again."""
    slow = np.abs(velocity) < SLOW * np.sqrt((velocity**2).mean(axis=0))
    return bool((slow.mean(axis=0) > STICKS).any())


def _quiet_lines(frequency: Float64, step: float, top: float, motion: tuple[int, Int64]) -> Int64:
    """Lines on which nothing but the sensors is seen; ``motion``: its periods, and the excited lines.

    The rounding of a periodic motion repeats with it and lies on the lines of the period: there it is read.
    Motion on odd lines alone returns reversed after half a period, and so does its rounding: most of it lies
    on odd lines.
    """
    periods, excited = motion
    low = min(max(QUIET_BAND[0] / step, WIDE * top), 0.3 / step)
    quiet = (frequency > low) & (frequency < QUIET_BAND[1] / step)
    number = np.arange(frequency.size)
    if periods and excited.size and np.all(excited % (2 * periods) == periods):
        quiet &= number % (2 * periods) == periods
    elif periods > 1:
        quiet &= number % periods == 0
    return np.flatnonzero(quiet)


def _level(lines: Complex128) -> Float64:
    """(M,) mean power of lines (F, M) of noise, from their median: single tones do not count."""
    out: Float64 = np.median(np.abs(lines) ** 2, axis=0) / np.log(2.0)
    return out


def _counts(position: Float64) -> Float64:
    """(M,) step of an encoder that the samples show; zero where nearly every sample differs from the last."""
    change = np.abs(np.diff(position, axis=0))
    seen = [np.quantile(c[c > 0], 0.01) if (c > 0).any() else 0.0 for c in change.T]
    out: Float64 = np.where((change > 0).mean(axis=0) < 0.9, seen, 0.0)
    return out


def _rounding(position: Float64, step: float, counts: Float64) -> Float64:
    """(M,) variance of the rounding of a sample, as far as it lies in the band of slow motion.

    An axis that passes fewer counts a second than half the sampling rate rounds slowly: its rounding lies
    below its own rate of counts.
    """
    rate = np.abs(np.diff(position, axis=0)).mean(axis=0) / step / np.maximum(counts, 1e-300)
    crowding = np.clip(0.5 / step / np.maximum(rate, 1e-9), 1.0, SLOWEST_COUNTS)
    return counts**2 / 12.0 * np.where(counts > 0, crowding, 1.0)


def _rounding_seen(position: Float64, counts: Float64, used: Int64) -> Float64:
    """(M,) mean power on the used lines of what rounding to counts does to this very motion.

    A periodic motion is rounded alike in every period, a slow one by slow errors: neither is white.
    """
    whole = position / np.where(counts > 0, counts, 1.0)
    error = np.where(counts > 0, np.round(whole) - whole, 0.0) * counts
    lines = transform(error, used[used > 0])
    out: Float64 = (np.abs(lines) ** 2).mean(axis=0)
    return out


def _smooth(position: Float64, step: float, top: float, noise: Float64) -> SmoothMotion:
    """Motion on the fine grid: mirrored beyond its ends, low-passed, lines taken by their share of signal.

    ``noise`` (M,) is the power of rounding on a line of the span.
    """
    count = position.shape[0] - 1
    fine = int(np.clip(np.ceil(FINENESS * top * step), 1, min(32, max(1, MOST_POINTS // count))))
    pad = min(512, count // 4)
    head = 2 * position[:1] - position[pad:0:-1]
    tail = 2 * position[-1:] - position[-2 : -pad - 2 : -1]
    long = np.concatenate((head, position, tail))
    size = long.shape[0]
    spectrum = np.fft.rfft(long, axis=0)
    frequency = np.fft.rfftfreq(size, step)
    edge = min(1.2 * WIDE * top, 0.45 / step)
    spectrum *= (0.5 - 0.5 * np.cos(np.pi * np.clip((edge - frequency) / (0.4 * edge), 0.0, 1.0)))[:, None]
    power = np.abs(spectrum) ** 2 * (2.0 / size) ** 2
    smooth = np.apply_along_axis(lambda p: np.convolve(p, np.ones(9) / 9, "same"), 0, power)
    spectrum *= np.clip(1.0 - 1.5 * noise * count / size / np.maximum(smooth, 1e-300), 0.0, 1.0)
    cut = slice(pad * fine, (pad + count) * fine + 1)
    where = np.fft.irfft(spectrum, size * fine, axis=0)[cut] * fine
    rate = np.fft.irfft(spectrum * (2j * np.pi * frequency)[:, None], size * fine, axis=0)[cut] * fine
    return SmoothMotion(where, rate, step / fine)


def _used_lines(frequency: Float64, top: float, periods: int) -> Int64:
    number = np.arange(frequency.size)
    if periods:
        ordinal = number // periods
        far = (frequency <= REACH * top) & (ordinal % SPARSE == 1)
        return np.flatnonzero((number % periods == 0) & ((frequency <= DENSE * top) | far))
    within = np.flatnonzero(frequency <= top)
    return within[:: 1 << max(0, -(-within.size // MOST_LINES) - 1).bit_length()]


def _hold_damping(
    lines: tuple[Float64, Complex128, Complex128], hold: Float64, free: np.ndarray, end: Float64
) -> Float64:
    """(M,) damping D of holds: torque = −K·position − D·velocity on the lines without a command.

    ``lines``: [rad/s], position, torque. ``free`` (A, M) which lines have none; ``end`` (M,) the jump of
    position
    over half the span. NaN where a hold is unknown, or explains less than nine tenths of what is left there.
    """
    omega, position, torque = lines
    out = np.full(hold.size, np.nan)
    velocity = 1j * omega[:, None] * position + end
    for m in np.flatnonzero(np.isfinite(hold) & (hold > 0)):
        at = free[:, m] & (omega > 0)
        whole = torque[at, m]
        rest, speed = whole + hold[m] * position[at, m], velocity[at, m]
        size = float((np.abs(speed) ** 2).sum())
        damping = -float((speed.conj() * rest).sum().real) / max(size, 1e-300)
        left = float((np.abs(rest + damping * speed) ** 2).sum())
        if left < UNEXPLAINED * float((np.abs(whole) ** 2).sum()):
            out[m] = damping
    return out


UNEXPLAINED = 0.1
"""Share of the torque on lines without a command that a hold may leave and still be one (empirical)."""
