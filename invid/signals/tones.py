"""Sinusoids that keep their own time: found on the lines between those of a period.

A period's lines hold what repeats; a sinusoid of another frequency f leaks over the lines k of the span,
a·e^{jπ(fT − k)}·sinc(fT − k), noise does not. A fan, a pump, another machine, or a loop that hunts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64, Int64
from invid.recording.model import Experiment, Recording

CHANCE = 1e-3
"""Chance, over all lines, that noise looks like a tone (statistical)."""
MOST_TONES = 3
"""Most tones looked for on one axis of one record."""
SHARE = 0.8
"""Least share of the power between a period's lines, beyond noise, that tones hold (empirical): what changes
with time has much of it on the lines beside those excited."""
NEAR = 12
"""Lines on either side from which a tone is read."""
FAINT = 0.2
"""Amplitude over the strongest tone's up to which another may be what that did to the fit (empirical)."""
SLOWEST = 1.0
"""Cycles in a record from which on it shows a tone: what is slower is a drift; its rest looks like tones."""
SWINGS = 2.0
"""Lines from a load's own frequency within which it swings there, and what else may is not told from that."""
DECAYS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Logarithmic decays over the span of what swings."""
NARROWED = 5
"""Times that the range of frequencies about a tone is narrowed, to a thousandth of a line."""
FINE = 161
APART = 0.9
"""Frequencies tried about a tone's strongest line, and how many lines from it they reach: closer to a line of
the period it is not told from what repeats."""


@dataclass(frozen=True)
class Tone:
    """A sinusoid's frequency [Hz] and amplitude, in the unit of the lines."""

    hz: float
    amplitude: float


def find_tones(lines: tuple[Complex128, Float64, Bool], span: float, own_hz: Float64) -> list[Tone]:
    """Tones on the lines k/T of a span T, the strongest first.

    None where they, and loads that swing, are not most of what stands above the noise.

    Parameters
    ----------
    lines
        Amplitudes (A,), power of their noise (A,), and on which (A,) tones are looked for.
    own_hz
        Frequencies of the loads with all motors held.
    """
    amplitude, noise, free = lines
    number = np.flatnonzero(free)
    if number.size < 2 * NEAR:
        return []
    rest, power = amplitude[number].copy(), noise[number]
    level = max(float(np.median(np.abs(rest) ** 2 / power)) / np.log(2.0), 1.0)
    power = power * level
    excess = float((np.abs(rest) ** 2 / power).sum()) - number.size
    limit = float(np.log(4.0 * number.size / CHANCE))
    found: list[Tone] = []
    taken = 0.0
    for _ in range(MOST_TONES):
        near = _near_peak(rest, power, number)
        best = near.read(0.0)
        if best.gain < limit:
            break
        swings = bool(np.any(np.abs(own_hz * span - best.cycles) < SWINGS))
        if swings:
            best = max((near.read(decay) for decay in DECAYS), key=lambda s: s.gain)
        elif best.cycles <= SLOWEST:
            return []
        rest = rest - best.lines(number)
        taken += best.gain
        if not swings:
            found.append(Tone(best.cycles / span, abs(best.size)))
    if not found or taken < SHARE * excess or _is_one_that_changes(found, span):
        return []
    return sorted(found, key=lambda t: -t.amplitude)


def _is_one_that_changes(tones: Sequence[Tone], span: float) -> bool:
    """Whether two like tones lie within two lines: what a resonance makes whose spring or load drifts."""
    return any(
        abs(a.hz - b.hz) * span < 2.0
        and min(a.amplitude, b.amplitude) > FAINT * max(a.amplitude, b.amplitude)
        for a, b in combinations(tones, 2)
    )


@dataclass(frozen=True)
class _Sinusoid:
    """One that begins at ``size`` and falls by e^−decay within the span, and what it tells of the lines."""

    cycles: float
    decay: float
    size: complex
    gain: float

    def lines(self, number: Int64) -> Complex128:
        """(A,) its amplitudes."""
        out: Complex128 = self.size * _leakage(self.cycles - number, self.decay)
        return out


@dataclass(frozen=True, eq=False)
class _Near:
    """The lines about the largest, whose number is ``peak``."""

    peak: int
    number: Int64
    rest: Complex128
    noise: Float64

    def read(self, decay: float) -> _Sinusoid:
        """The sinusoid of this decay that tells most."""
        cycles: Float64 = self.peak + np.linspace(-APART, APART, FINE)
        shape = _leakage(cycles[:, None] - self.number, decay)
        told = (shape.conj() / self.noise * self.rest).sum(axis=1)
        known = (np.abs(shape) ** 2 / self.noise).sum(axis=1)
        gain = np.abs(told) ** 2 / np.maximum(known, 1e-300)
        best = int(np.argmax(gain))
        return _Sinusoid(float(cycles[best]), decay, complex(told[best] / known[best]), float(gain[best]))


def _near_peak(rest: Complex128, power: Float64, number: Int64) -> _Near:
    peak = int(number[np.argmax(np.abs(rest) ** 2 / power)])
    near = np.abs(number - peak) <= NEAR
    return _Near(peak, number[near], rest[near], power[near])


def _leakage(cycles: np.ndarray, decay: float) -> Complex128:
    """Amplitude on a line ``cycles`` of the span away from a sinusoid that falls from one to e^−decay."""
    turn = 2j * np.pi * cycles - decay
    still = turn == 0.0
    out: Complex128 = np.where(still, 1.0, np.expm1(turn) / np.where(still, 1.0, turn))
    return out


def remove_tones(recording: Recording, hz: Sequence[float]) -> Recording:
    """The recording without sinusoids of these frequencies in the channels of its periodic experiments."""
    experiments = tuple(_without(e, hz) if e.periods > 1 else e for e in recording.experiments)
    return replace(recording, experiments=experiments)


def refine_tones(recording: Recording, hz: Sequence[float]) -> list[float]:
    """The frequencies near ``hz`` that explain most of what differs from period to period."""
    periodic = [e for e in recording.experiments if e.periods > 1]
    out = list(hz)
    for k in range(len(out)):
        width = 0.5 / max(e.periods * e.period_samples / e.sample_rate_hz for e in periodic)
        for _ in range(NARROWED):
            tried = [[*out[:k], f, *out[k + 1 :]] for f in out[k] + np.linspace(-width, width, 9)]
            out = min(tried, key=lambda own: sum(_phasors(e, own)[1] for e in periodic))
            width /= 4.0
    return out


def tone_phasors(experiment: Experiment, hz: Sequence[float]) -> Complex128:
    """(tones, 2M) phasors of positions and torques, read from what differs from the mean of the last whole
    periods: each channel holds Re(phasor·e^{2πjf(t − t₀)}), t₀ the experiment's first instant."""
    return _phasors(experiment, hz)[0]


def _phasors(experiment: Experiment, hz: Sequence[float]) -> tuple[Complex128, float]:
    """Phasors, and the share that they leave of what differs, summed over channels."""
    count, period = experiment.periods, experiment.period_samples

    def differing(values: Float64) -> Float64:
        whole = values[-count * period :].reshape(count, period, -1)
        out: Float64 = (whole - whole.mean(axis=0)).reshape(count * period, -1)
        return out

    waves = _waves(experiment, hz)
    both = differing(np.concatenate((waves.real, -waves.imag), axis=1))
    goal = differing(np.concatenate((experiment.position, experiment.torque), axis=1))
    size, *_ = np.linalg.lstsq(both, goal, rcond=None)
    left = ((goal - both @ size) ** 2).sum(axis=0) / np.maximum((goal**2).sum(axis=0), 1e-300)
    phasors: Complex128 = size[: len(hz)] + 1j * size[len(hz) :]
    return phasors, float(left.sum())


def _waves(experiment: Experiment, hz: Sequence[float]) -> Complex128:
    return np.exp(2j * np.pi * np.outer(experiment.time - experiment.time[0], hz))


def _without(experiment: Experiment, hz: Sequence[float]) -> Experiment:
    both = (_waves(experiment, hz) @ tone_phasors(experiment, hz)).real
    motors = experiment.position.shape[1]
    return replace(
        experiment,
        position=experiment.position - both[:, :motors],
        torque=experiment.torque - both[:, motors:],
    )
