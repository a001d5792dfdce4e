"""A simulator guided along a recorded motion: the torque that its guide adds is what it misses.

Driven by the recorded torque alone every simulator of a free axis drifts away, a right one too: it
integrates each error twice. So it is given the recorded torque T and a guide that holds each motor to its
recorded motion θ,

    T_sim = T + e,   e = k (θ − θ_sim) + d (θ̇ − θ̇_sim),

well above the excited band. What the simulator stays behind would have asked its dynamic stiffness Z for
more: ê = e + Z (θ − θ_sim) is the torque that the motors would still need for the measured motion, on the
lines of the prepared record and up to what the record's two ends ask of the motors, V(α + jωβ), which nobody
measured of the inner masses. It has the unit and the meaning of the diagnosis' residual, and any engine that
takes torques and gives positions can be judged by it.
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
from invid.model.matrices import Condensed
from invid.numerics.arrays import Complex128, Float64, Int64
from invid.recording.model import Experiment
from invid.signals.motion_record import derivative
from invid.signals.record import Record, make_record, transform
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
DRAWS = 2
"""Draws of a record's noise from which it is told what noise leaves a simulator that is no linear plant."""
RUN_IN = 2
"""Periods before a record that begins in motion: a mode of 0.5 % damping at 6 Hz, of periods of 4 s, has lost
four fifths of its start by then, and what is left of it is free motion."""
SAME_TIME = 0.05
"""Share of a sample by which the torque's time may be wrong in a run: a hundredth of its phase at most in any
band."""
ENDS = 4.0
"""Periods of the band's top at either end of a record without a period that are not judged."""
READINGS = 4
"""Runs of a record at most, until the torque is read at the time at which it acts."""
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
    """Inputs of one experiment: ``torque`` and ``position`` (n, M) at the samples, of which ``judged`` are
    the span that is judged, both its ends included; before it stands what brings a simulator to its start.

    ``low``, ``high`` [Hz] is the band that is judged; ``sampling`` how the torque was read from its samples.
    """

    record: Record
    torque: Float64
    position: Float64
    judged: slice
    low: float
    high: float
    sampling: Sampling

    @property
    def key(self) -> str:
        """Of the experiment."""
        return self.record.key

    @property
    def interval(self) -> float:
        """Of the samples [s]."""
        return self.record.step

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

    def missing(self, guide: Float64, position: Float64, plant: Model) -> Complex128:
        """(F, M) spectrum of the missing torque, its rms² the sum of squares, of a guide's torque (n, M) and
        the simulated motors (n, M)."""
        seen = _seen_by_motors(plant, 2 * np.pi * self.frequencies)
        asked = self._spectrum(guide) + _times(seen.stiffness, self._spectrum(self.position - position))
        ends = seen.jumps(2 * np.pi * self.frequencies)
        columns, flat = (_real_rows(x.reshape(asked.size, -1)) for x in (ends, asked))
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        share = np.linalg.lstsq(columns / size, flat[:, 0], rcond=1e-9)[0]
        return np.asarray(asked - (ends / size @ share))

    def blurred(self, step: float, model: Model) -> Float64:
        """(F, M) power of the torque by which a right plant is wrong if solved in a fixed ``step`` [s]."""
        omega = 2 * np.pi * self.frequencies
        apart = _seen_by_motors(model, omega, step).stiffness - _seen_by_motors(model, omega).stiffness
        return np.asarray(np.abs(_times(apart, self._spectrum(self.position))) ** 2)

    def changed(self, by: Sampling, plant: Model) -> Complex128:
        """(F, M) by which a simulator's torque grows if it is read so much later and held for more.

        The simulator's own path of torque, as ``plant`` has it, lies between.
        """
        turn = 2j * np.pi * self.frequencies[:, None]
        less = 1.0 - by.held / 12.0 * (1.0 - np.cosh(turn * self.interval).real)
        own = self._spectrum(self.torque)
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

    def noisier(self, rng: np.random.Generator) -> Guided:
        """The same with as much noise again."""
        draws = [np.sqrt(v) * rng.standard_normal(self.torque.shape) for v in self._variances]
        return replace(
            self,
            torque=self.torque + draws[0],
            position=self.position + _smooth(draws[1], self.interval, self.high),
        )

    @property
    def unmoved(self) -> Float64:
        """(M,) speed at which a motor stays within the encoder's noise for a period of the band's top."""
        return np.asarray(np.sqrt(self._variances[1]) * self.high)

    @property
    def frequencies(self) -> Float64:
        """(F,) [Hz] of the lines that are judged."""
        return np.asarray(self._numbers / self._span)

    def floor(self, model: Model) -> Float64:
        """(F, M) power that the noise of torque and encoder leaves a line, through the plant of ``model``."""
        z = np.abs(_seen_by_motors(model, 2 * np.pi * self.frequencies).stiffness) ** 2
        torque, position = self._variances
        return np.asarray(2.0 * self.interval / self._span * (torque + z @ position))

    @property
    def _span(self) -> float:
        """Of the samples that are judged [s]."""
        return float((self.judged.stop - self.judged.start - 1) * self.interval)

    @property
    def _numbers(self) -> Int64:
        """(F,) numbers of the lines in the band, those of the period where the record has one."""
        number = np.arange(0, int(0.5 * self._span / self.interval), max(self.record.periods, 1))
        hz = number / self._span
        return np.asarray(number[(hz >= 0.999 * self.low) & (hz <= 1.001 * self.high)])

    @property
    def _variances(self) -> tuple[Float64, Float64]:
        """(M,) of the noise of a sample of torque and position."""
        samples = 0.25 * self.record.span / self.interval
        return self.record.torque_noise * samples, self.record.position_noise * samples

    def _spectrum(self, x: Float64) -> Complex128:
        return np.asarray(transform(x[self.judged], self._numbers) / np.sqrt(2.0))


_STRUCTURE = ("viscous_friction", "spring_damping", "coupling_stiffness", "extra_mode", "base_compliance")
"""Causes that are linear in the motion."""


def _times(stiffness: Complex128, position: Complex128) -> Complex128:
    return np.asarray((stiffness @ position[..., None])[..., 0])


def _real_rows(x: Complex128) -> Float64:
    return np.asarray(np.concatenate([x.real, x.imag]))


def _seen_by_motors(plant: Model, omega: Float64, step: float = 0.0) -> Condensed:
    """What motors see of the chains with all viscous damping, that of the effects too, at ω > 0 [rad/s].

    By semi-implicit Euler of so long a ``step`` [s], if given: ω is sin(ωh/2)·2/h, damping is late by h/2.
    """
    linear = tuple(t for t in plant.effects if t.cause in _STRUCTURE)
    made, w = matrices(plant.chains, laws_of(plant.chains, linear)), np.asarray(omega)[:, None, None]
    turn = np.exp(-0.5j * step * w)
    if step:
        w = 2.0 / step * np.sin(0.5 * step * w)
    dynamic = made.stiffness + 1j * w * turn * made.damping - w**2 * made.mass
    return Condensed.of(dynamic, plant.chains.motor_dofs.tolist())


class Simulator(Protocol):
    """A simulator of any engine."""

    path: str
    engine: str
    """Its engine with the version: "MuJoCo 4.0.0"."""
    step: float
    """The one step [s] it takes; 0 where it takes any."""

    def prepared(self, records: Sequence[Guided]) -> list[str]:
        """In sentences, what of the file is not simulated as it stands, and why."""

    def claimed(self) -> Model | None:
        """What it says of the plant, as chains and effects; ``None`` where it is no chain of masses."""

    def guide(self, given: Guided) -> tuple[Float64, Float64]:
        """(n, M) each: torque of the guide at the samples, by the engine, and the motors' positions there."""

    def corrected(self, model: Model, to: Path) -> tuple[Simulator, Sequence[str]]:
        """Writes a copy that says what ``model`` says; with it what its format cannot hold, in sentences."""


def stiff_guide(mass: Float64, rate: float) -> tuple[Float64, Float64]:
    """Stiffness and damping (M,) of a critically damped guide of natural frequency ``rate`` [rad/s]."""
    return mass * rate**2, 2.0 * mass * rate


def guided(experiment: Experiment, sampling: Sampling, count: Float64 | None = None) -> Guided:
    """Inputs for a simulator from one experiment; ``count`` (M,) [rad or m] of the encoders, where known."""
    e, record = resample_uniformly(experiment), make_record(experiment, count)
    interval = e.step
    stated = experiment.frequencies_hz[experiment.frequencies_hz > 0]
    low = float(stated.min()) if stated.size else 2.0 / (e.samples * interval)
    high = min(record.top_hz, HIGHEST / interval)
    # Beyond a sample it is a delay, no convention.
    sampling = Sampling(np.clip(sampling.later, -interval, interval), sampling.held)
    torque, position = _sampled(e.torque, interval, sampling), _smooth(e.position, interval, high)
    if round(record.span / interval) == e.samples:  # the span's last instant is a sample after the last
        torque = np.concatenate((torque, 2 * torque[-1:] - torque[-2:-1]))
        position = np.concatenate((position, 3 * position[-1:] - 3 * position[-2:-1] + position[-3:-2]))
    speed = np.abs(np.diff(position, axis=0))
    n = experiment.period_samples if record.periods > 1 else 0
    if (speed[:3] < AT_REST * speed.max(axis=0)).all():
        before = [np.repeat(x[:1], round(WARM_UP / interval), axis=0) for x in (torque, position)]
    else:  # the first period as often as it takes, without its drift
        drift = position[n] - position[0]
        before = [
            np.concatenate([torque[:0], *[torque[:n]] * RUN_IN]),
            np.concatenate([position[:0], *(position[:n] - k * drift for k in range(RUN_IN, 0, -1))]),
        ]
    torque, position = np.concatenate((before[0], torque)), np.concatenate((before[1], position))
    # The motion is less well known at the ends of a record, where nothing goes on.
    last, cut = torque.shape[0], 0 if record.periods else round(ENDS / high / interval)
    judged = slice(last - round(record.span / interval) - 1 + cut, last - cut)
    return Guided(record, torque, position, judged, low, high, sampling)


def missing_torque(simulator: Simulator, given: Guided, plant: Model) -> Complex128:
    """(F, M) spectrum of what a simulator misses on one record."""
    return given.missing(*simulator.guide(given), plant)


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

    def run(read: list[Guided]) -> tuple[list[Complex128], Sampling]:
        found = [missing_torque(simulator, g, plant) for g in read]
        return found, _sampling(read, found, plant)

    read = list(records)
    runs, by = run(read)
    for _ in range(READINGS - 1):
        if max(np.abs(by.later).max() / read[0].interval, np.abs(by.held).max()) <= SAME_TIME:
            break
        read = [g.read(by) for g in read]
        runs, by = run(read)
    spectra = [x - g.changed(by, plant) for x, g in zip(runs, read, strict=True)]
    return Missed(read, spectra, runs)


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
