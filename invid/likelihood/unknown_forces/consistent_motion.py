"""Motion at a place that agrees with the laws of it.

The smoother takes a law φ of a place's motion d at the motion of the fit before. Its error there, δd, makes
an error φ'·δd of the force, which moves the place anew: where a chain resonates with its motors held, that
grows from one smoothing to the next. Here both agree. With resistance F = φ(d) + e, e of power Q, and the
missing torque r = r₀ + H·F + E·a of covariance S (a the records' ends), d = d₀ − X·F + B·a, a step of F and a
minimises

    |r + H·δF + E·δa|² by S  +  |F + δF − φ(d) + φ'·(X·δF − B·δa)|² by Q,

φ' a factor in time, all else on lines.

Where a load hangs free in a gap most of the time many motions are such minima: which contact is when? The
motion is followed from a law that is averaged over wide offsets of d, which has one, to the law itself
(graduated non-convexity, Blake and Zisserman 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invid.effects.supposed.law import SpotMotion
from invid.likelihood.unknown_forces.smoother import SmoothedStack
from invid.numerics.arrays import Complex128, Float64, Int64
from invid.numerics.newton_descent import descend, solve_normal
from invid.signals.record import Record

LEAST_POWER = 0.1
"""Least Q over the torque's noise: no law is the machine's to more than a third of what a line shows."""
TIED = 1e-6
"""Diagonal beside ends that a record cannot tell apart."""
DIFFERENCE = 1e-4
"""Step of motion over its deviation for a law's derivative."""
SEEN = 4.0
"""Deviations of χ² by which force and law of a record part further than Q lets expect (statistical)."""
BLURS = (1.5, 0.75, 0.35, 0.15)
"""Offsets over the deviation of the motion up to which a law is averaged, one after another."""
OFFSETS = np.linspace(-1.0, 1.0, 7)[1:-1]
WEIGHTS = np.cos(OFFSETS * np.pi / 2.0) ** 2
"""Where in such offsets a law is asked for, and how much each counts."""


@dataclass(frozen=True, eq=False)
class LawOfMotion:
    """The laws of a place together, as a resistance over time (k,) of its motion, the motion of each record
    of a stack as it is smoothed, and that on which the smoother took the laws; ``stride``: instants from one
    to the next on which the resistance is asked for."""

    resistance: Callable[[SpotMotion], Float64]
    smoothed: Sequence[SpotMotion]
    before: Sequence[SpotMotion]
    stride: int

    def lines(self, record: Record, motion: SpotMotion) -> Complex128:
        """(A,) resistance of a record's motion on its lines."""
        return record.wide_lines(self.resistance(motion.every(self.stride)))

    def of_records(self, which: Int64) -> LawOfMotion:
        """The same of some of the records."""
        smoothed, before = ([m[k] for k in which] for m in (self.smoothed, self.before))
        return replace(self, smoothed=smoothed, before=before)

    def averaged(self, share: float, stride: int) -> LawOfMotion:
        """The laws averaged over offsets of up to a ``share`` of the deviation of the motion."""
        wide = share * float(np.std(np.concatenate([m.position for m in self.smoothed])))

        def resistance(motion: SpotMotion) -> Float64:
            moved = (replace(motion, position=motion.position + wide * u) for u in OFFSETS)
            return np.average([self.resistance(m) for m in moved], axis=0, weights=WEIGHTS)

        return replace(self, resistance=resistance, stride=max(self.stride, stride))


def agree(stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> SmoothedStack:
    """A stack's motion with that at a place, along ``vector`` (n,), as its laws and the records together have
    it."""
    rows = _Rows.of(stack, place, vector, law)
    start = _At.of(rows, rows.nothing)
    if not any(s.any() for s in start.slopes):  # a law of the past of the motion, or of none
        return stack
    found = descend(start)
    expected = rows.expected
    apart = np.flatnonzero(found.costs_of_law > expected + SEEN * np.sqrt(2.0 * expected))
    if not apart.size:
        return rows.moved(found.change)
    other = _from_afar(rows.of_records(apart))
    better = apart[other.costs < found.costs[apart]]
    change = found.change.with_records(better, other.change, np.searchsorted(apart, better))
    return rows.moved(change)


def _from_afar(rows: _Rows) -> _At:
    """The motion that is followed from laws averaged over wide offsets to the laws themselves."""
    change = rows.nothing
    for share in BLURS:
        change = descend(
            _At.of(replace(rows, law=rows.law.averaged(share, rows.stack.stride)), change)
        ).change
    return descend(_At.of(rows, change))


@dataclass(frozen=True, eq=False)
class _Change:
    """Change of F on lines (R, A), and of the ends (R, 2n) in units of their rows."""

    force: Complex128
    ends: Float64

    def plus(self, other: _Change) -> _Change:
        return _Change(self.force + other.force, self.ends + other.ends)

    def with_records(self, which: Int64, other: _Change, theirs: Int64) -> _Change:
        """With some records as ``theirs`` of another change."""
        force, ends = self.force.copy(), self.ends.copy()
        force[which], ends[which] = other.force[theirs], other.ends[theirs]
        return _Change(force, ends)


@dataclass(frozen=True, eq=False)
class _Rows:
    """What a stack says of F, on A lines.

    ``missing`` (R, A, M), ``reach`` (A, M), ``jumps`` (A, M, 2n): r, H and E, whitened. ``receptance`` (A,):
    X. ``by_ends``: motion by each end alone; ``swing``: B, position and velocity at the place by it, (2n,
    k + 1) each.
    """

    stack: SmoothedStack
    place: int
    vector: Float64
    law: LawOfMotion
    missing: Complex128
    reach: Complex128
    jumps: Complex128
    power: Float64
    receptance: Complex128
    by_ends: SmoothedStack
    swing: tuple[Float64, Float64]
    force: Complex128

    @classmethod
    def of(cls, stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> _Rows:
        noise, omega = stack.noise, stack.omega
        reach, power = noise.reach[:, :, place], noise.power[:, place]
        others = noise.power.copy()
        others[:, place] = 0.0
        whitener = stack.noise_of(others, stack.stack.position_noise).whitener
        jumps = whitener @ stack.condensed.jumps(omega)
        length = np.sqrt(((np.abs(jumps) ** 2).sum(axis=1) * stack.weight[:, None]).sum(axis=0)) + 1e-300
        unknown = -stack.force[:, :, place]
        missing = stack.missing + unknown[..., None] * reach
        was = [law.lines(r, m) for r, m in zip(stack.stack.records, law.before, strict=True)]
        by_ends = stack.motion_by_ends(np.eye(length.size) / length)
        return cls(
            stack,
            place,
            vector,
            law,
            (whitener @ missing[..., None])[..., 0],
            (whitener @ reach[..., None])[..., 0],
            jumps / length,
            np.maximum(power, LEAST_POWER * float(stack.stack.torque_noise.mean())),
            stack.condensed.receptance @ vector @ vector,
            by_ends,
            by_ends.over_time(vector),
            np.array(was) + unknown,
        )

    def of_records(self, which: Int64) -> _Rows:
        """The same of some of the records."""
        stack, law = self.stack.of_records(which), self.law.of_records(which)
        return replace(self, stack=stack, law=law, missing=self.missing[which], force=self.force[which])

    @property
    def nothing(self) -> _Change:
        """No change."""
        return _Change(np.zeros_like(self.force), np.zeros((self.force.shape[0], self.swing[0].shape[0])))

    @property
    def expected(self) -> float:
        """Squares of force less law by Q of one record, on average where what is unknown has the power Q."""
        told = self.power * (np.abs(self.reach) ** 2).sum(axis=1)
        return float((told / (1.0 + told)) @ self.stack.weight)

    def told(self, change: _Change) -> Complex128:
        """(R, A, M) whitened torque of a change."""
        ends = np.tensordot(change.ends.astype(complex), self.jumps, (1, 2))
        return change.force[..., None] * self.reach + ends

    def told_back(self, rows: Complex128) -> _Change:
        """The adjoint of ``told``."""
        ends = np.tensordot(rows * self.stack.weight[:, None], self.jumps.conj(), ((1, 2), (0, 1)))
        return _Change((rows * self.reach.conj()).sum(axis=2), ends.real)

    def moved(self, change: _Change) -> SmoothedStack:
        """The stack's motion after a change."""
        stack, swing, ends = self.stack, self.by_ends, change.ends
        force = stack.force.copy()
        force[:, :, self.place] -= change.force
        answer = stack.condensed.receptance @ self.vector
        lines = stack.lines - change.force[..., None] * answer + np.tensordot(ends, swing.lines, 1)
        jump, bend = stack.jump + ends @ swing.jump, stack.bend + ends @ swing.bend
        return replace(stack, lines=lines, jump=jump, bend=bend, force=force)


@dataclass(frozen=True, eq=False)
class _At:
    """The motion of each record after a change, and the laws of it on lines (R, A)."""

    rows: _Rows
    change: _Change
    motion: tuple[SpotMotion, ...]
    law: Complex128

    @classmethod
    def of(cls, rows: _Rows, change: _Change) -> _At:
        stack, law = rows.stack, rows.law
        pushed = -rows.receptance * change.force
        by_force = (stack.wave(pushed), stack.wave(1j * stack.omega * pushed))
        position, velocity = (w + change.ends @ s for w, s in zip(by_force, rows.swing, strict=True))
        motion = tuple(
            replace(was, position=was.position + p, velocity=was.velocity + v)
            for was, p, v in zip(law.smoothed, position, velocity, strict=True)
        )
        lines = [law.lines(r, m) for r, m in zip(stack.stack.records, motion, strict=True)]
        return cls(rows, change, motion, np.array(lines))

    @cached_property
    def slopes(self) -> tuple[Float64, Float64]:
        """(R, k) derivatives of the laws by position and by velocity on the coarse grid."""
        every, resistance = self.rows.stack.stride, self.rows.law.resistance
        by_position, by_velocity = zip(
            *(_slopes(resistance, m.every(every)) for m in self.motion), strict=True
        )
        return np.array(by_position), np.array(by_velocity)

    @cached_property
    def missing(self) -> Complex128:
        """(R, A, M) whitened missing torque."""
        return self.rows.missing + self.rows.told(self.change)

    @cached_property
    def apart(self) -> Complex128:
        """(R, A) force less what the laws say."""
        return self.rows.force + self.change.force - self.law

    @cached_property
    def costs_of_law(self) -> Float64:
        """(R,) squares of force less law by its power Q."""
        out: Float64 = (np.abs(self.apart) ** 2 / self.rows.power) @ self.rows.stack.weight
        return out

    @cached_property
    def costs(self) -> Float64:
        """(R,) the sum of squares of each record."""
        told: Float64 = (np.abs(self.missing) ** 2).sum(axis=2) @ self.rows.stack.weight
        return told + self.costs_of_law

    @property
    def cost(self) -> float:
        return float(self.costs.sum())

    def moved(self, step: Float64) -> _At:
        return _At.of(self.rows, self.change.plus(self._unpack(step)))

    def step(self) -> Float64:
        rows = self.rows

        def normal(values: Float64) -> Float64:
            u = self._unpack(values)
            return self._pack(
                rows.told_back(rows.told(u)).plus(self._drift_back(self._drift(u) / rows.power))
            )

        pull = rows.told_back(self.missing).plus(self._drift_back(self.apart / rows.power))
        return solve_normal(normal, -self._pack(pull))

    @cached_property
    def _answers(self) -> tuple[Complex128, Complex128]:
        omega, receptance = self.rows.stack.omega, self.rows.receptance
        return receptance, 1j * omega * receptance

    @cached_property
    def _swing(self) -> tuple[Float64, Float64]:
        """By the ends on the grid of the slopes."""
        position, velocity = (s[:, : -1 : self.rows.stack.stride] for s in self.rows.swing)
        return position, velocity

    def _drift(self, u: _Change) -> Complex128:
        """How far force and laws part by a change."""
        stack, parts = self.rows.stack, zip(self.slopes, self._answers, self._swing, strict=True)
        felt = [f * (stack.coarse_wave(a * u.force) - u.ends @ b) for f, a, b in parts]
        return u.force + stack.coarse_lines(_sum(felt))

    def _drift_back(self, w: Complex128) -> _Change:
        stack = self.rows.stack
        felt = [f * stack.coarse_wave(w) for f in self.slopes]
        force = [a.conj() * stack.coarse_lines(f) for f, a in zip(felt, self._answers, strict=True)]
        ends = _sum([f @ b.T for f, b in zip(felt, self._swing, strict=True)])
        return _Change(w + _sum(force), np.asarray(ends * (-2.0 / felt[0].shape[1]), dtype=np.float64))

    @cached_property
    def _scales(self) -> tuple[Float64, Float64]:
        """Roots of the diagonal that the laws' mean slope makes: of forces (R, A), of the ends (2n, 2n)
        inverted."""
        rows, stack = self.rows, self.rows.stack
        mean = _sum([f.mean(axis=1)[:, None] * a for f, a in zip(self.slopes, self._answers, strict=True)])
        own = (np.abs(rows.reach) ** 2).sum(axis=1) + np.abs(1.0 + mean) ** 2 / rows.power
        flat = (rows.jumps * np.sqrt(stack.weight)[:, None, None]).reshape(-1, rows.swing[0].shape[0])
        swung = stack.coarse_lines(
            _sum([f.mean() * b for f, b in zip(self.slopes, self._swing, strict=True)])
        )
        swung = swung * np.sqrt(stack.weight / rows.power)
        block = (flat.conj().T @ flat).real + (swung @ swung.conj().T).real + TIED * np.eye(flat.shape[1])
        return np.sqrt(own), np.asarray(np.linalg.inv(np.linalg.cholesky(block)), dtype=np.float64)

    def _pack(self, pull: _Change) -> Float64:
        own, ends = self._scales
        force = pull.force * np.sqrt(self.rows.stack.weight) / own
        return np.concatenate((force.real.ravel(), force.imag.ravel(), (pull.ends @ ends.T).ravel()))

    def _unpack(self, values: Float64) -> _Change:
        own, ends = self._scales
        half = own.size
        force: Complex128 = (values[:half] + 1j * values[half : 2 * half]).reshape(own.shape)
        return _Change(
            np.asarray(force / own / np.sqrt(self.rows.stack.weight), dtype=np.complex128),
            values[2 * half :].reshape(own.shape[0], -1) @ ends,
        )


def _slopes(resistance: Callable[[SpotMotion], Float64], at: SpotMotion) -> tuple[Float64, Float64]:
    """(k,) derivatives by position and by velocity, without the last instant, which is the first."""

    def slope(low: SpotMotion, high: SpotMotion, step: float) -> Float64:
        out: Float64 = ((resistance(high) - resistance(low)) / (2.0 * step))[:-1]
        return out

    p, v = (DIFFERENCE * float(w.std()) + 1e-300 for w in (at.position, at.velocity))
    return (
        slope(replace(at, position=at.position - p), replace(at, position=at.position + p), p),
        slope(replace(at, velocity=at.velocity - v), replace(at, velocity=at.velocity + v), v),
    )


def _sum(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.asarray(np.sum(parts, axis=0))
