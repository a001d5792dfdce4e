"""Motion at a place that agrees with the laws of it.

The smoother takes a law φ of a place's motion d at the motion of the fit before. Its error there, δd, makes
an error φ'·δd of the force, which moves the place anew: where a chain resonates with its motors held, that
grows from one smoothing to the next. Here both agree. With resistance F = φ(d) + e, e of power Q, and the
missing torque r = r₀ + H·F + E·a of covariance S (a the records' ends), d = d₀ − X·F + B·a with all else that
is unknown at its best for F and a, a step of F and a minimises

    |r + H·δF + E·δa|² by S  +  |F + δF − φ(d) + φ'·(X·δF − B·δa)|² by Q  +  |a + δa|²/2,

φ' a factor in time, which is a Toeplitz and a Hankel matrix on lines, a in deviations. Of the lines those are
unknown on which a force moves the place; on those beyond, F is what the law says. A step is damped (Levenberg
1944, Marquardt 1963), for a contact that is elsewhere makes another slope.

Where a load hangs free in a gap most of the time many motions are such minima: which contact is when? The
motion is followed from a law that is averaged over wide offsets of d, which has one, to the law itself
(graduated non-convexity, Blake and Zisserman 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from invid.effects.supposed.law import SpotMotion
from invid.likelihood.unknown_forces.smoother import SmoothedStack
from invid.numerics.arrays import Complex128, Float64, Int64
from invid.numerics.newton_descent import ARRIVED
from invid.signals.record import Record

LEAST_POWER = 0.1
"""Least Q over the torque's noise: no law is the machine's to more than a third of what a line shows."""
DIFFERENCE = 1e-4
"""Step of motion over its deviation for a law's derivative."""
BLURS = (1.5, 0.75, 0.35, 0.15)
"""Offsets over the deviation of the motion up to which a law is averaged, one after another."""
OFFSETS = np.linspace(-1.0, 1.0, 7)[1:-1]
WEIGHTS = np.cos(OFFSETS * np.pi / 2.0) ** 2
"""Where in such offsets a law is asked for, and how much each counts."""
FOLLOWING, MOST_LINES = 0.1, 600
"""Share of its motion by which a place's own spring moves it, below which on higher lines the force follows
the law; and most lines on which it does not (numerical: the work grows with their cube)."""
STEPS, STEPS_ON_THE_WAY = 8, 3
"""Most steps with the laws, and with each that is averaged."""
DAMPING, EASED = 1e-2, 0.1
"""First damping of a step over its diagonal, and what a step that lowers the squares leaves of it."""

Law = Callable[[SpotMotion], Float64]
"""Resistance over time (k,) of a motion."""


@dataclass(frozen=True, eq=False)
class LawOfMotion:
    """The laws of a place together, as a resistance of its motion.

    ``smoothed``: the motion of each record of a stack as it is smoothed; ``before``: that on which the
    smoother took the laws, in ``agreed`` where it agreed with them. ``stride``: instants from one to the next
    on which the resistance is asked for. ``is_smooth``: nothing comes into contact.
    """

    resistance: Law
    smoothed: Sequence[SpotMotion]
    before: Sequence[SpotMotion]
    agreed: SmoothedStack | None
    stride: int
    is_smooth: bool

    def lines(self, record: Record, motion: SpotMotion) -> Complex128:
        """(A,) resistance of a record's motion on its lines."""
        return record.wide_lines(self.resistance(motion.every(self.stride)))

    @cached_property
    def deviation(self) -> float:
        """Deviation of the smoothed motion in all records."""
        return float(np.std(np.concatenate([m.position for m in self.smoothed])))

    def averaged(self, share: float, stride: int) -> LawOfMotion:
        """The laws averaged over offsets of up to a ``share`` of the deviation of the motion."""
        wide = share * self.deviation

        def resistance(motion: SpotMotion) -> Float64:
            moved = (replace(motion, position=motion.position + wide * u) for u in OFFSETS)
            return np.average([self.resistance(m) for m in moved], axis=0, weights=WEIGHTS)

        return replace(self, resistance=resistance, stride=max(self.stride, stride))


def agree(stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> SmoothedStack:
    """A stack's motion with that at a place, along ``vector`` (n,), as its laws and the records together have
    it."""
    at = _Place.of(stack, place, vector, law)
    nothing = np.zeros_like(stack.force[..., place]), np.zeros_like(stack.ends)
    smoothed = at.changed(law, *nothing)
    if not any(s.any() for start in smoothed for s in start.slopes):  # of the past of the motion, or of none
        return stack
    starts, was = smoothed, law.agreed
    if was is not None:
        before = at.changed(law, stack.force[..., place] - was.force[..., place], was.ends - stack.ends)
        starts = [min(pair, key=lambda start: start.cost) for pair in zip(smoothed, before, strict=True)]
    found = [_descend(start, STEPS) for start in starts]
    if not law.is_smooth and was is None:
        pairs = zip(found, map(_from_afar, smoothed), strict=True)
        found = [min(pair, key=lambda end: end.cost) for pair in pairs]
    return at.moved(found)


def _from_afar(start: _At) -> _At:
    """The motion that is followed from laws averaged over wide offsets to the laws themselves, on the lines
    of the record's period until there."""
    law, now = start.law, start.on(start.at.repeating)
    for share in BLURS:
        now = _descend(now.by(law.averaged(share, start.at.stack.stride)), STEPS_ON_THE_WAY)
    return _descend(now.on(start.at).by(law), STEPS)


def _descend(now: _At, steps: int) -> _At:
    """Where no damped step lowers the sum of squares by much."""
    damping = DAMPING
    for _ in range(steps):
        found = now.stepped(damping)
        if found.cost >= now.cost:
            damping /= EASED
            continue
        gained, now, damping = now.cost - found.cost, found, damping * EASED
        if gained < ARRIVED * now.cost:
            break
    return now


@dataclass(frozen=True, eq=False)
class _Change:
    """Change of F on lines (A,), and of the ends (2n,) in deviations."""

    force: Complex128
    ends: Float64


@dataclass(frozen=True, eq=False)
class _Place:
    """What a stack says of F at a place.

    ``missing`` (R, A, M), ``reach`` (A, M), ``jumps`` (A, M, 2n): r, H and E, whitened. ``answer`` (A, n):
    motion of all coordinates by F, ``receptance`` (A,) X. ``by_ends``: motion by each end alone; ``ends``,
    ``ends_rate`` (2n, k + 1): B, position and velocity by it. ``force`` (R, A): F. ``unknown`` (L,): lines on
    which F does not follow the law; it does ``beyond``.
    """

    stack: SmoothedStack
    place: int
    vector: Float64
    law: LawOfMotion
    missing: Complex128
    reach: Complex128
    jumps: Complex128
    power: Float64
    answer: Complex128
    receptance: Complex128
    by_ends: SmoothedStack
    ends: Float64
    ends_rate: Float64
    force: Complex128
    unknown: Int64
    beyond: int

    @classmethod
    def of(cls, stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> _Place:
        noise, omega = stack.noise, stack.omega
        reach, power = noise.reach[:, :, place], noise.power[:, place]
        others = noise.power.copy()
        others[:, place] = 0.0
        beside = stack.noise_of(others, stack.position_noise)
        whitener = beside.whitener
        unknown = -stack.force[:, :, place]
        missing = stack.missing + unknown[..., None] * reach
        was = [law.lines(r, m) for r, m in zip(stack.stack.records, law.before, strict=True)]
        answer = stack.answer_to(reach[..., None], beside)[..., 0] - stack.condensed.receptance @ vector
        receptance = -(answer @ vector)
        jumps = stack.condensed.jumps(omega) @ stack.root
        by_ends, more = stack.motion_by_ends(), stack.answer_to(jumps, beside)
        by_ends = replace(by_ends, lines=by_ends.lines + np.moveaxis(more, 2, 0))
        moving = np.flatnonzero(np.abs(receptance) * (law.smoothed[0].own or 0.0) > FOLLOWING)
        beyond = min(MOST_LINES, int(moving.max(initial=0)) + 1)
        return cls(
            stack,
            place,
            vector,
            law,
            (whitener @ missing[..., None])[..., 0],
            (whitener @ reach[..., None])[..., 0],
            whitener @ jumps,
            np.maximum(power, LEAST_POWER * float(stack.stack.torque_noise.mean())),
            answer,
            receptance,
            by_ends,
            *by_ends.over_time(vector),
            np.array(was) + unknown,
            np.arange(beyond),
            beyond,
        )

    @cached_property
    def repeating(self) -> _Place:
        """The same with the lines of the records' period alone unknown."""
        periods = max(1, self.stack.stack.records[0].periods)
        return replace(self, unknown=self.unknown[self.unknown % periods == 0])

    @cached_property
    def told(self) -> Float64:
        """(2L + 2n, 2L + 2n) squares of whitened torque and of the ends, by real and imaginary F on the
        unknown lines and by the ends."""
        some, weight = self.unknown, self.stack.weight
        reach = self.reach.conj() * weight[:, None]
        own = np.tile((reach[some] * self.reach[some]).real.sum(axis=1), 2)
        cross = (reach[some, :, None] * self.jumps[some]).sum(axis=1)
        rows = (self.jumps * np.sqrt(weight)[:, None, None]).reshape(-1, self.jumps.shape[2])
        cross = np.concatenate((cross.real, cross.imag))
        ends = (rows.conj().T @ rows).real + 0.5 * np.eye(rows.shape[1])
        return np.block([[np.diag(own), cross], [cross.T, ends]])

    def changed(self, law: LawOfMotion, force: Complex128, ends: Float64) -> list[_At]:
        """Where all records are after changes of force (R, A) and ends (R, 2n)."""
        pairs = enumerate(zip(force, ends, strict=True))
        return [_At.of(self, k, law, _Change(*pair)) for k, pair in pairs]

    def moved(self, found: Sequence[_At]) -> SmoothedStack:
        """The stack's motion where all its records are found."""
        stack, swing = self.stack, self.by_ends
        pushed, ends = (np.array([getattr(f.change, name) for f in found]) for name in ("force", "ends"))
        force = stack.force.copy()
        force[:, :, self.place] = [-f.apart for f in found]
        lines = stack.lines + pushed[..., None] * self.answer + np.tensordot(ends, swing.lines, 1)
        jump, bend = stack.jump + ends @ swing.jump, stack.bend + ends @ swing.bend
        return replace(stack, lines=lines, jump=jump, bend=bend, ends=stack.ends + ends, force=force)


@dataclass(frozen=True, eq=False)
class _At:
    """The motion of a record after a change, and the ``said`` force (A,) of its laws."""

    at: _Place
    record: int
    law: LawOfMotion
    change: _Change
    motion: SpotMotion
    said: Complex128

    @classmethod
    def of(cls, at: _Place, record: int, law: LawOfMotion, change: _Change) -> _At:
        pushed = -at.receptance * change.force
        position = at.stack.wave(pushed) + change.ends @ at.ends
        velocity = at.stack.wave(1j * at.stack.omega * pushed) + change.ends @ at.ends_rate
        was = at.law.smoothed[record]
        motion = replace(was, position=was.position + position, velocity=was.velocity + velocity)
        said = law.lines(at.stack.stack.records[record], motion)
        return cls(at, record, law, change, motion, said)

    def by(self, law: LawOfMotion) -> _At:
        """The same motion with other laws."""
        return _At.of(self.at, self.record, law, self.change)

    def on(self, at: _Place) -> _At:
        """The same where other lines are unknown."""
        return replace(self, at=at)

    @cached_property
    def slopes(self) -> tuple[Float64, Float64]:
        """(k,) derivatives of the laws by position and by velocity on the coarse grid."""
        return _slopes(self.law.resistance, self.motion.every(self.at.stack.stride))

    @cached_property
    def missing(self) -> Complex128:
        """(A, M) whitened missing torque."""
        at, change = self.at, self.change
        out: Complex128 = at.missing[self.record] + change.force[:, None] * at.reach + at.jumps @ change.ends
        return out

    @cached_property
    def apart(self) -> Complex128:
        """(A,) force less what the laws say."""
        return np.asarray(self.at.force[self.record] + self.change.force - self.said)

    @cached_property
    def swung(self) -> Float64:
        """(2n,) the ends in deviations."""
        return np.asarray(self.at.stack.ends[self.record] + self.change.ends)

    @cached_property
    def cost(self) -> float:
        """The sum of squares."""
        lines = (np.abs(self.missing) ** 2).sum(axis=1) + np.abs(self.apart) ** 2 / self.at.power
        return float(lines @ self.at.stack.weight) + 0.5 * float(self.swung @ self.swung)

    def stepped(self, damping: float) -> _At:
        """The motion after a damped step on the unknown lines, beyond them as the law there has it."""
        at, lines, count = self.at, self.at.unknown, self.at.unknown.size
        matrix, pull = self._normal
        unit = np.sqrt(np.diag(matrix)) + 1e-300
        scaled = matrix / unit[:, None] / unit
        scaled[np.diag_indices_from(scaled)] += damping
        step = -cho_solve(cho_factor(scaled, check_finite=False), pull / unit) / unit
        force = self.change.force.copy()
        force[lines] += step[:count] + 1j * step[count : 2 * count]
        found = _At.of(at, self.record, self.law, _Change(force, self.change.ends + step[2 * count :]))
        followed = np.concatenate((force[: at.beyond], (force - found.apart)[at.beyond :]))
        return _At.of(at, self.record, self.law, replace(found.change, force=followed))

    @cached_property
    def _normal(self) -> tuple[Float64, Float64]:
        """The matrix of a step without damping, and half the gradient."""
        at, some, weight = self.at, self.at.unknown, self.at.stack.weight
        share = np.sqrt(weight / at.power)[some]
        by_law = self._drift * np.tile(share, 2)[:, None]
        away = self.apart[some] * share
        back = (self.missing * at.reach.conj()).sum(axis=1)[some] * weight[some]
        ends = np.tensordot(self.missing * weight[:, None], at.jumps.conj(), 2).real + 0.5 * self.swung
        told = np.concatenate((back.real, back.imag, ends))
        return by_law.T @ by_law + at.told, by_law.T @ np.concatenate((away.real, away.imag)) + told

    @property
    def _drift(self) -> Float64:
        """(2L, 2L + 2n) how far force and laws part on the unknown lines by real and imaginary force on them,
        and by the ends."""
        at, stack, lines = self.at, self.at.stack, self.at.unknown
        answers = at.receptance[lines], 1j * stack.omega[lines] * at.receptance[lines]
        straight, turned = np.eye(lines.size, dtype=complex), np.zeros((lines.size,) * 2, dtype=complex)
        swung = np.zeros((lines.size, at.ends.shape[0]), dtype=complex)
        halved = np.where(lines == 0, 0.5, 1.0)  # a wave's mean is half its line
        for factor, answer, ends in zip(self.slopes, answers, (at.ends, at.ends_rate), strict=True):
            toeplitz, hankel = _product(factor, lines)
            straight += toeplitz * answer * halved
            turned += hankel * answer.conj() * halved
            swung -= stack.coarse_lines(factor * ends[:, : -1 : stack.stride])[:, lines].T
        real, imaginary = straight + turned, straight - turned
        return np.block([[real.real, -imaginary.imag, swung.real], [real.imag, imaginary.real, swung.imag]])


def _product(factor: Float64, lines: Int64) -> tuple[Complex128, Complex128]:
    """(L, L) T and K with which a wave of ``lines`` (L,) u, times a factor (k,) in time, has on them
    T·u + K·u*."""
    found = np.fft.rfft(factor) / factor.size
    found = np.pad(found, (0, max(0, 2 * int(lines.max()) + 1 - found.size)))
    apart = lines[:, None] - lines
    toeplitz = np.where(apart >= 0, found[np.abs(apart)], found[np.abs(apart)].conj())
    return toeplitz, found[lines[:, None] + lines]


def _slopes(resistance: Law, at: SpotMotion) -> tuple[Float64, Float64]:
    """(k,) derivatives by position and by velocity, without the last instant, which is the first."""

    def slope(low: SpotMotion, high: SpotMotion, step: float) -> Float64:
        out: Float64 = ((resistance(high) - resistance(low)) / (2.0 * step))[:-1]
        return out

    p, v = (DIFFERENCE * float(w.std()) + 1e-300 for w in (at.position, at.velocity))
    return (
        slope(replace(at, position=at.position - p), replace(at, position=at.position + p), p),
        slope(replace(at, velocity=at.velocity - v), replace(at, velocity=at.velocity + v), v),
    )
