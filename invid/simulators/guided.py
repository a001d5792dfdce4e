"""A simulator guided along a recorded motion: the torque that its guide adds is what it misses.

Driven by the recorded torque alone every simulator of a free axis drifts away, a right one too: it
integrates each error twice. So it is given the recorded torque T and a guide that holds each motor to its
recorded motion θ,

    T_sim = T + e,   e = k (θ − θ_sim) + d (θ̇ − θ̇_sim),

well above the excited band. What the simulator stays behind, e/(k + jωd), would have asked its dynamic
stiffness Z for more: ê = e + Z e/(k + jωd) is the torque that the motors would still need for the measured
motion. It has the unit and the meaning of the diagnosis' residual, and any engine that takes torques and
gives positions can be judged by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.optimize import minimize_scalar

from invid.model.document import Model
from invid.model.matrices import Condensed, Matrices
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.recording.model import Experiment
from invid.signals.motion_record import derivative
from invid.signals.record import make_record
from invid.signals.timebase import resample_uniformly
from invid.simulation.laws import laws_of
from invid.simulation.plant import matrices
from invid.simulation.rigid import time_offsets

BANDS = 6
"""Bands in which the missing torque is told, evenly spaced in the logarithm of frequency."""
BEYOND_BAND = 2.0
"""The guide follows the motion up to this multiple of the band's top: above is the encoder's noise."""
GUIDE = 5.0
"""The guide's natural frequency over the band's top at least."""
HIGHEST = 0.2
"""Highest frequency that is judged, over the sample rate."""
WARM_UP = 1.0
"""Seconds at the first position before a record that begins at rest: the load comes to rest as well."""
EARLY = 4.0
"""Cycles of the slowest free motion from which the start is estimated: later a nonlinear spring has turned
it."""
STARTS = 6
"""Runs of an engine a record at most, to find where the inner masses began."""
DRAWS = 2
"""Draws of a record's noise from which it is told what noise leaves a simulator that is no linear plant."""
RUN_IN = 2
"""Periods before a record that begins in motion, for an engine that begins at rest: a mode of 0.5 % damping
at 6 Hz, of periods of 4 s, has lost four fifths of its start by then, and what is left of it is taken out."""
SAME_TIME = 0.05
"""Share of a sample by which the torque's time may be wrong in a run: a hundredth of its phase at most in any
band."""
AT_REST = 0.01
"""Speed over the largest one below which a record begins at rest."""


@dataclass(frozen=True, eq=False)
class Sampling:
    """What the identification found of the torque's samples (M,): they act ``later`` [s], and a share
    ``held`` of each stands until the next."""

    later: Float64
    held: Float64

    @classmethod
    def of(cls, model: Model) -> Sampling:
        """As the model's fit reports it; nothing where it does not."""
        offsets, shares = time_offsets(model), model.fit.get("held_over_sample") or {}
        held = [shares.get(f"{a}.held_over_sample", {}).get("value", 0.0) for a in model.axes]
        return cls(np.array([offsets.get(i, 0.0) for i in range(len(model.axes))]), np.clip(held, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Guided:
    """Inputs of one experiment: ``torque`` and ``position`` (n, M) at the samples.

    ``lead`` samples stand before the record; ``low``, ``high`` [Hz] is the band that is judged. ``period`` is
    in samples, 0 where nothing repeats.
    """

    key: str
    interval: float
    lead: int
    period: int
    torque: Float64
    position: Float64
    low: float
    high: float
    sampling: Sampling
    """How the torque was read from its samples."""
    noise: tuple[Float64, Float64]
    """Variances a sample of torque and position (M,), from above the band."""

    def fine(
        self, step: float, *, torque: float = 0.0, speed: float = 0.0
    ) -> tuple[int, Float64, Float64, Float64]:
        """Steps a sample, then torque, position and velocity on the simulator's steps.

        Two are read so many steps on: a torque that an engine holds over each half a step, the velocity where
        the engine's own stands.
        """
        every = max(1, int(np.ceil(self.interval / step - 1e-9)))
        t = np.arange(self.torque.shape[0]) * self.interval
        at, one = np.arange((t.size - 1) * every + 1) * self.interval / every, self.interval / every
        # Quintic: the acceleration of a cubic one is (ωh)²/12 too large at the samples, where it is read.
        motion = make_interp_spline(t, self.position, k=5)
        held, now = (np.clip(at + x * one, 0.0, t[-1]) for x in (torque, speed))
        return every, CubicSpline(t, self.torque)(held), motion(at), motion(now, 1)

    def missing(self, guide: Float64, tie: Tie, plant: Model) -> tuple[Complex128, Float64]:
        """(F, M) spectrum of the missing torque of a guide's torque (n, M); rms² is its sum of squares.

        With it (2, inner masses): how far the inner positions and velocities began from the machine's.

        Where the inner masses began nobody measured: their free motion behind held motors, by the chains of
        ``plant``, is taken out.
        """
        asked = _asked(guide, tie, plant, self.interval)[guide.shape[0] - self.torque.shape[0] + self.lead :]
        found = self._spectrum(asked)
        free, slowest = _free_motion(plant, self.interval, asked.shape[0])
        if not free.shape[0]:
            return found, np.zeros((2, 0))
        # Times t as well: an engine's modes decay and turn a little otherwise than the chains'.
        both = np.concatenate([free, free * np.linspace(0.0, 1.0, free.shape[1])[:, None]])
        left, _ = _without(found, [self._spectrum(f) for f in both])
        first = min(free.shape[1], round(EARLY / slowest / self.interval))
        fall = np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, first)) ** 2
        early = [self._early(f[:first], fall) for f in (guide[-asked.shape[0] :], *free)]
        _, began = _without(early[0], early[1:])
        return left, began.reshape(2, -1)

    def blurred(self, step: float, model: Model) -> Float64:
        """(F, M) power of the torque by which a right plant is wrong if solved in a fixed ``step`` [s]."""
        omega = 2 * np.pi * self.frequencies
        apart = motor_stiffness(model, omega, step) - motor_stiffness(model, omega)
        torque = np.einsum("fij,fj->fi", apart, self._spectrum(self.position[self.lead :]))
        return np.asarray(np.abs(torque) ** 2)

    def _early(self, x: Float64, fall: Float64) -> Complex128:
        hz = np.fft.rfftfreq(fall.size, self.interval).astype(np.float64)
        out: Complex128 = np.fft.rfft(x * fall[:, None], axis=0)[self._inside(hz)]
        return out

    def changed(self, by: Sampling, plant: Model) -> Complex128:
        """(F, M) by which a simulator's torque grows if it is read so much later and held for more.

        The simulator's own path of torque, as ``plant`` has it, lies between.
        """
        turn = 2j * np.pi * self.frequencies[:, None]
        less = 1.0 - by.held / 12.0 * (1.0 - np.cosh(turn * self.interval).real)
        own = self._spectrum(self.torque[self.lead :])
        for i, term in ((plant.axes.index(t.axis), t) for t in plant.effects):
            if term.cause == "torque_delay":
                own[:, i] *= np.exp(-turn[:, 0] * term.value("delay"))
            elif term.cause == "torque_lag":
                own[:, i] /= 1.0 + turn[:, 0] * term.value("time_constant")
        return np.asarray(own * (np.exp(-turn * by.later) * less - 1.0))

    def read(self, by: Sampling) -> Guided:
        """The same with the torque read so much later and held for more."""
        torque = _sampled(self.torque, self.interval, by)
        now = Sampling(self.sampling.later + by.later, self.sampling.held + by.held)
        return replace(self, torque=torque, sampling=now)

    def run_in(self) -> Guided:
        """The record with its first period ``RUN_IN`` times before it.

        Where it begins in motion and repeats; else nothing more.
        """
        n = 0 if self.lead else self.period
        drift = self.position[n] - self.position[0]
        before = [self.position[:n] - k * drift for k in range(RUN_IN, 0, -1)]
        torque = np.concatenate([*[self.torque[:n]] * RUN_IN, self.torque])
        lead, position = self.lead + RUN_IN * n, np.concatenate([*before, self.position])
        return replace(self, lead=lead, torque=torque, position=position)

    def noisier(self, rng: np.random.Generator) -> Guided:
        """The same with as much noise again."""
        count = self.torque.shape[0] - self.lead
        draws = [np.sqrt(v) * rng.standard_normal((count, v.size)) for v in self.noise]
        draws[1] = _smooth(draws[1], self.interval, self.high)
        torque, position = (np.concatenate([np.repeat(x[:1], self.lead, axis=0), x]) for x in draws)
        return replace(self, torque=self.torque + torque, position=self.position + position)

    @property
    def unmoved(self) -> Float64:
        """(M,) speed at which a motor stays within the encoder's noise for a period of the band's top."""
        return np.asarray(np.sqrt(self.noise[1]) * self.high)

    @property
    def frequencies(self) -> Float64:
        """(F,) [Hz], the whole band."""
        hz = np.fft.rfftfreq(self.torque.shape[0] - self.lead, self.interval).astype(np.float64)
        out: Float64 = hz[self._inside(hz)]
        return out

    def _inside(self, hz: Float64) -> Bool:
        out: Bool = (hz >= 0.999 * self.low) & (hz <= 1.001 * self.high)
        return out

    def _spectrum(self, x: Float64) -> Complex128:
        window = np.hanning(x.shape[0])
        hz = np.fft.rfftfreq(x.shape[0], self.interval).astype(np.float64)
        scale = np.sqrt(2.0 / x.shape[0] / (window**2).sum())
        out: Complex128 = np.fft.rfft(x * window[:, None], axis=0)[self._inside(hz)] * scale
        return out

    def floor(self, model: Model) -> Float64:
        """(F, M) power that the noise of torque and encoder leaves a line, through the plant of ``model``."""
        torque, position = self.noise
        z = np.abs(motor_stiffness(model, 2 * np.pi * self.frequencies)) ** 2
        return np.asarray(2.0 / (self.torque.shape[0] - self.lead) * (torque + z @ position))


@dataclass(frozen=True, eq=False)
class Tie:
    """Stiffness and damping of a guide (M,), and how much later it acts than it is read [s]."""

    stiffness: Float64
    damping: Float64
    late: float = 0.0

    @classmethod
    def of(cls, mass: Float64, rate: float) -> Tie:
        """Natural frequency ``rate`` [rad/s] on these inertias, critically damped."""
        return cls(mass * rate**2, 2.0 * mass * rate)


def _without(x: Complex128, columns: Sequence[Complex128]) -> tuple[Complex128, Float64]:
    """A spectrum (F, M) less its projection on others, and the real shares of these."""
    flat = np.stack([np.concatenate([c.real.ravel(), c.imag.ravel()]) for c in (x, *columns)], axis=1)
    size = np.maximum(np.linalg.norm(flat[:, 1:], axis=0), 1e-300)
    share = np.linalg.lstsq(flat[:, 1:] / size, flat[:, 0], rcond=1e-9)[0]
    left = flat[:, 0] - flat[:, 1:] / size @ share
    return (left[: x.size] + 1j * left[x.size :]).reshape(x.shape), share / size


def _asked(guide: Float64, tie: Tie, plant: Model, interval: float) -> Float64:
    """(n, M) torque of the guide, and what its lag would have asked the plant for more: e + Z e/(k + jωd).

    Before any window: near an antiresonance Z turns faster than a window's lines stand apart.
    """
    count = guide.shape[0]
    fall = np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, count)) ** 2
    padded = np.concatenate([guide, guide[-1] * fall[:, None]])
    omega = 2 * np.pi * np.fft.rfftfreq(2 * count, interval).astype(np.float64)
    away = np.fft.rfft(padded, axis=0) / (tie.stiffness + 1j * omega[:, None] * tie.damping)
    more = np.zeros_like(away)
    more[1:] = np.einsum("fij,fj->fi", motor_stiffness(plant, omega[1:]), away[1:])
    late = np.fft.rfft(padded, axis=0) * np.exp(-1j * omega[:, None] * tie.late)
    return np.asarray(np.fft.irfft(late + more, 2 * count, axis=0)[:count])


def _linear(plant: Model) -> Matrices:
    """Matrices of the chains with all their viscous damping, that of the effects too."""
    damping = tuple(t for t in plant.effects if t.cause in ("viscous_friction", "spring_damping"))
    return matrices(plant.chains, laws_of(plant.chains, damping))


def motor_stiffness(plant: Model, omega: Float64, step: float = 0.0) -> Complex128:
    """(F, M, M) dynamic stiffness at the motors, at ω > 0 [rad/s].

    With all the damping: at an antiresonance that alone bounds it, and a soft guide is far off there. By
    semi-implicit Euler of so long a ``step`` [s], if given: ω is sin(ωh/2)·2/h, and damping is late by h/2.
    """
    made, w = _linear(plant), np.asarray(omega)[:, None, None]
    turn = np.exp(-0.5j * step * w)
    if step:
        w = 2.0 / step * np.sin(0.5 * step * w)
    dynamic = made.stiffness + 1j * w * turn * made.damping - w**2 * made.mass
    return Condensed.of(dynamic, plant.chains.motor_dofs.tolist()).stiffness


def _free_motion(plant: Model, interval: float, count: int) -> tuple[Float64, float]:
    """(2 inner masses, count, M): torque on held motors after a unit of each inner position and velocity; the
    lowest frequency in it [Hz]."""
    made = _linear(plant)
    motors = plant.chains.motor_dofs
    inner = np.setdiff1d(np.arange(made.mass.shape[0]), motors)
    n = inner.size
    if not n:
        return np.zeros((0, count, motors.size)), np.inf
    to, rate = np.ix_(motors, inner), made.among(inner.tolist()).rates
    value, vector = np.linalg.eig(rate)
    decay = np.exp(np.outer(np.arange(count) * interval, value))
    pull = np.hstack([made.stiffness[to], made.damping[to]]) + made.mass[to] @ rate[n:]
    weight = np.linalg.inv(vector)
    modes = pull @ vector
    out = np.stack([((decay * weight[:, k]) @ modes.T).real for k in range(2 * n)])
    return np.asarray(out), float(np.abs(value).min() / (2.0 * np.pi))


class Simulator(Protocol):
    """A simulator of any engine."""

    path: str
    engine: str
    """Its engine with the version: "MuJoCo 4.0.0"."""
    restarts: bool
    """Whether its inner masses can be started anywhere."""
    step: float
    """The one step [s] it takes; 0 where it takes any."""

    def prepared(self, records: Sequence[Guided]) -> list[str]:
        """In sentences, what of the file is not simulated as it stands, and why."""

    def claimed(self) -> Model | None:
        """What it says of the plant, as chains and effects; ``None`` where it is no chain of masses."""

    def guide(self, given: Guided, start: Float64 | None) -> tuple[Float64, Tie]:
        """(n, M) torque of the guide at the samples, by the engine, and the guide's numbers.

        More samples than the record's are what ran before it.

        ``start`` (2, inner masses): positions and velocities of the inner masses beyond those of their motor,
        for an engine that can be started anywhere.
        """

    def corrected(self, model: Model, to: Path) -> tuple[Simulator, Sequence[str]]:
        """Writes a copy that says what ``model`` says; with it what its format cannot hold, in sentences."""


def guided(experiment: Experiment, sampling: Sampling, count: Float64 | None = None) -> Guided:
    """Inputs for a simulator from one experiment; ``count`` (M,) [rad or m] of the encoders, where known."""
    e = resample_uniformly(experiment)
    interval = e.step
    stated = experiment.frequencies_hz[experiment.frequencies_hz > 0]
    low = float(stated.min()) if stated.size else 2.0 / (e.samples * interval)
    high = min(make_record(experiment, count).top_hz, HIGHEST / interval)
    # Beyond a sample it is a delay, no convention.
    sampling = Sampling(np.clip(sampling.later, -interval, interval), sampling.held)
    torque = _sampled(e.torque, interval, sampling)
    noise = _noise(e.torque, interval, high), _noise(e.position, interval, high)
    if count is not None:
        noise = noise[0], np.maximum(noise[1], np.nan_to_num(count) ** 2 / 12.0)
    position = _smooth(e.position, interval, high)
    speed = np.abs(np.diff(position, axis=0))
    lead = round(WARM_UP / interval) if (speed[:3] < AT_REST * speed.max(axis=0)).all() else 0
    torque, position = (np.concatenate([np.repeat(x[:1], lead, axis=0), x]) for x in (torque, position))
    period = experiment.period_samples / experiment.sample_rate_hz / interval
    period = round(period) if abs(period - round(period)) < 1e-3 and period < e.samples else 0
    return Guided(experiment.key, interval, lead, period, torque, position, low, high, sampling, noise)


def missing_torque(simulator: Simulator, given: Guided, plant: Model) -> Complex128:
    """(F, M) spectrum of what a simulator misses on one record.

    A nonlinear spring turns a wrong start into more than free motion of chains, so the simulator is started
    anew where the inner masses seem to have been, as long as that leaves less.
    """
    start: Float64 | None = None
    least = np.inf
    best: Complex128 | None = None
    for _ in range(STARTS):
        found, away = given.missing(*simulator.guide(given, start), plant)
        size = float(np.linalg.norm(found))
        if best is None or size < least:
            best = found
        if not simulator.restarts or given.lead or not away.size or not size < 0.95 * least:
            break
        least, start = size, (np.zeros_like(away) if start is None else start) - away
    assert best is not None  # noqa: S101 - STARTS is above zero
    return best


@dataclass(frozen=True, eq=False)
class Missed:
    """What a simulator misses on records as they were read for it.

    ``spectra`` (F, M) a record; ``runs`` before the last change of how the torque is read.
    """

    records: list[Guided]
    spectra: list[Complex128]
    runs: list[Complex128]


def missed(simulator: Simulator, records: Sequence[Guided], plant: Model) -> Missed:
    """What a simulator misses on each record, each axis' torque read as much later as leaves least.

    Within a sample of the record that is convention, which a diagnosis that explains little gets wrong. Run
    anew where it was wrong by more than ``SAME_TIME``: friction turns it into more than a phase.
    """
    runs = [missing_torque(simulator, g, plant) for g in records]
    by = _sampling(records, runs, plant)
    if (np.abs(by.later) > SAME_TIME * records[0].interval).any() or (np.abs(by.held) > SAME_TIME).any():
        records = [g.read(by) for g in records]
        runs = [missing_torque(simulator, g, plant) for g in records]
        by = _sampling(records, runs, plant)
    spectra = [x - g.changed(by, plant) for x, g in zip(runs, records, strict=True)]
    return Missed(list(records), spectra, runs)


def moved_by_noise(simulator: Simulator, found: Missed, plant: Model) -> list[Float64]:
    """(F, M) power by which a record's noise, drawn anew, changes what a simulator misses.

    Friction behind a spring and play keep what noise did to them: more than a linear plant lets through.
    """
    rng, out = np.random.default_rng(0), []
    for g, run in zip(found.records, found.runs, strict=True):
        again = [missing_torque(simulator, g.noisier(rng), plant) for _ in range(DRAWS)]
        out.append(np.mean([np.abs(x - run) ** 2 for x in again], axis=0))
    return out


def _sampling(records: Sequence[Guided], spectra: Sequence[Complex128], plant: Model) -> Sampling:
    """Change of how the torque is read that leaves least of spectra of missing torque, within bounds."""
    sample, now = min(g.interval for g in records), records[0].sampling
    none = np.zeros(now.later.size)

    def left(later: Float64, held: Float64) -> Complex128:
        by = Sampling(later, held)
        return np.concatenate([m - g.changed(by, plant) for m, g in zip(spectra, records, strict=True)])

    def held_at(later: Float64) -> Float64:
        """The share that leaves least, linear in it."""
        at = left(later, none)
        one = left(later, none + 1.0) - at
        best = -np.real(np.conj(one) * at).sum(axis=0) / np.maximum((np.abs(one) ** 2).sum(axis=0), 1e-300)
        return np.asarray(np.clip(best, -now.held, 1.0 - now.held))

    def size(later: float, i: int) -> float:
        times = none + later
        return float(np.linalg.norm(left(times, held_at(times))[:, i]))

    later = np.array(
        [
            minimize_scalar(size, args=(i,), bounds=(-sample - o, sample - o), method="bounded").x
            for i, o in enumerate(now.later)
        ]
    )
    return Sampling(later, held_at(later))


def _smooth(position: Float64, interval: float, high: float) -> Float64:
    """The motion without what lies beyond the band whose top is ``high`` [Hz]."""
    return derivative(position, interval, BEYOND_BAND * high, 0, (1.0, 1.5))


def _sampled(torque: Float64, interval: float, by: Sampling) -> Float64:
    """(n, M) read so much later, and as what a share held over each sample leaves of it."""
    t = np.arange(torque.shape[0]) * interval
    read = [CubicSpline(t, c)(np.clip(t - o, 0.0, t[-1])) for c, o in zip(torque.T, by.later, strict=True)]
    out = np.stack(read, axis=1)
    # A staircase over the step h has lost (ωh)²/24 of a sine, as second differences take it.
    out[1:-1] += by.held / 24.0 * np.diff(out, 2, axis=0)
    return out


def _noise(x: Float64, interval: float, high: float) -> Float64:
    """(M,) variance a sample of white noise, from the quiet half of the spectrum above twice the band."""
    window, hz = np.hanning(x.shape[0]), np.fft.rfftfreq(x.shape[0], interval)
    quiet = np.fft.rfft(x * window[:, None], axis=0)[hz > min(2.5 * high, 0.8 * hz[-1])]
    # The power of complex noise is exponential: its mean is the median over ln 2.
    return np.asarray(np.median(np.abs(quiet) ** 2, axis=0) / np.log(2.0) / float((window**2).sum()))
