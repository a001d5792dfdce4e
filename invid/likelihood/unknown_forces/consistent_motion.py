"""Motion at a place that agrees with the laws of it.

The smoother takes a law φ of a place's motion d at the motion of the fit before. Its error there, δd, makes
an error φ'·δd of the force, which moves the place anew: where a chain resonates with its motors held, that
grows from one smoothing to the next. Here both agree. With resistance F = φ(d) + e, e of power Q, and the
missing torque r = r₀ + H·F + E·a of covariance S (a the records' ends), d = d₀ − X·F + B·a, Newton's step of
F and a minimises

    |r + H·δF + E·δa|² by S  +  |F + δF − φ(d) + φ'·(X·δF − B·δa)|² by Q,

φ' a factor in time, all else on lines: by conjugate gradients, two transforms there and two back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from invid.effects.supposed.law import SpotMotion
from invid.likelihood.unknown_forces.smoother import SmoothedStack
from invid.numerics.arrays import Complex128, Float64
from invid.signals.record import Record

STEPS, SHARES = 2, (1.0, 0.5, 0.25)
"""Most of Newton's steps, and shares of one that are tried."""
ITERATIONS, TOLERANCE = 40, 1e-2
"""Most conjugate gradients of a step, and the share of its right side that they leave."""
ARRIVED = 4.0
"""Fall of the sum of squares below which the steps end."""
LEAST_POWER = 1e-2
"""Least Q over the torque's noise: no law is the machine's to more than a tenth of what a line shows."""
LEFT = 0.3
"""What they leave of it at most to be at the end: the sum of squares, which is −2 ln L, then falls by no more
than about its square."""
TIED = 1e-6
"""Diagonal beside ends that a record cannot tell apart."""
OVERSAMPLING = 4
"""Least instants of the grid of φ' for each line."""
DIFFERENCE = 1e-4
"""Step of motion over its deviation for a law's derivative."""


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


@dataclass(frozen=True, eq=False)
class _Change:
    """Change of F on lines (R, A), and of the ends (R, 2n) in units of their rows."""

    force: Complex128
    ends: Float64

    def plus(self, other: _Change, share: float = 1.0) -> _Change:
        return _Change(self.force + share * other.force, self.ends + share * other.ends)


@dataclass(frozen=True, eq=False)
class _LawAt:
    """φ on lines (R, A), its derivatives by position and by velocity (R, k)."""

    lines: Complex128
    slopes: tuple[Float64, Float64]

    @property
    def is_of_motion(self) -> bool:
        return any(s.any() for s in self.slopes)


@dataclass(frozen=True, eq=False)
class _Rows:
    """What a stack says of F, on A lines.

    ``missing`` (R, A, M), ``reach`` (A, M), ``jumps`` (A, M, 2n): r, H and E, whitened. ``receptance`` (A,):
    X; ``swing``, the motion by the ends, position and velocity over time (2n, k + 1): B.
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
    swing: SmoothedStack
    force: Complex128

    @classmethod
    def of(cls, stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> _Rows:
        noise, omega = stack.noise, stack.omega
        reach, power = noise.reach[:, :, place], noise.power[:, place]
        rest = noise.covariance - power[:, None, None] * reach[:, :, None] * reach[:, None].conj()
        whitener = np.linalg.inv(np.linalg.cholesky(rest))
        jumps = whitener @ stack.condensed.jumps(omega)
        length = np.sqrt(((np.abs(jumps) ** 2).sum(axis=1) * stack.weight[:, None]).sum(axis=0)) + 1e-300
        unknown = -stack.force[:, :, place]
        missing = stack.missing + unknown[..., None] * reach
        records = stack.stack.records
        was = [law.lines(r, m) for r, m in zip(records, law.before, strict=True)]
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
            stack.by_ends(np.eye(length.size) / length),
            np.array(was) + unknown,
        )

    def left(self, change: _Change) -> Complex128:
        """(R, A, M) whitened missing torque after a change."""
        return self.missing + self.told(change)

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
        force = self.stack.force.copy()
        force[:, :, self.place] -= change.force
        answer = self.stack.condensed.receptance @ self.vector
        ends, swing = change.ends, self.swing
        lines = self.stack.lines - change.force[..., None] * answer + np.tensordot(ends, swing.lines, 1)
        jump, bend = (w + ends @ s for w, s in ((self.stack.jump, swing.jump), (self.stack.bend, swing.bend)))
        return replace(self.stack, lines=lines, jump=jump, bend=bend, force=force)


def agree(stack: SmoothedStack, place: int, vector: Float64, law: LawOfMotion) -> SmoothedStack:
    """A stack's motion with that at a place, along ``vector`` (n,), as its laws and the records together have
    it."""
    rows = _Rows.of(stack, place, vector, law)
    swing = rows.swing.over_time(vector)
    change = _Change(np.zeros_like(rows.force), np.zeros((rows.force.shape[0], swing[0].shape[0])))
    now = _law_at(rows, change, swing)
    cost = _cost(rows, change, now)
    for _ in range(STEPS if now.is_of_motion else 0):
        step = _step(rows, change, now, swing)
        for share in SHARES:
            trial = change.plus(step, share)
            found = _law_at(rows, trial, swing)
            changed = _cost(rows, trial, found)
            if changed < cost:
                break
        else:
            break
        gained, cost, change, now = cost - changed, changed, trial, found
        if gained < ARRIVED:
            break
    return rows.moved(change)


Swing = tuple[Float64, Float64]
"""Position and velocity at the place by the ends, (2n, k + 1) each."""


def _law_at(rows: _Rows, change: _Change, swing: Swing) -> _LawAt:
    """The laws on the motion after a change."""
    stack, law = rows.stack, rows.law
    pushed = -rows.receptance * change.force
    by_force = (stack.wave(pushed), stack.wave(1j * stack.omega * pushed))
    position, velocity = (w + change.ends @ s for w, s in zip(by_force, swing, strict=True))
    stride = stack.stride(OVERSAMPLING)
    lines, slopes = [], []
    for record, was, p, v in zip(stack.stack.records, law.smoothed, position, velocity, strict=True):
        motion = replace(was, position=was.position + p, velocity=was.velocity + v)
        lines.append(law.lines(record, motion))
        slopes.append(_slopes(law.resistance, motion.every(stride)))
    by_position, by_velocity = (np.array(s) for s in zip(*slopes, strict=True))
    return _LawAt(np.array(lines), (by_position, by_velocity))


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


def _apart(rows: _Rows, change: _Change, now: _LawAt) -> Complex128:
    return rows.force + change.force - now.lines


def _cost(rows: _Rows, change: _Change, now: _LawAt) -> float:
    told = (np.abs(rows.left(change)) ** 2).sum(axis=2)
    apart = np.abs(_apart(rows, change, now)) ** 2 / rows.power
    return float(((told + apart) * rows.stack.weight).sum())


def _step(rows: _Rows, change: _Change, now: _LawAt, swing: Swing) -> _Change:
    """Newton's step, the law linear about where it stands."""
    count, lines = rows.force.shape
    grid, root = now.slopes[0].shape[1], np.sqrt(rows.stack.weight)
    answer = (rows.receptance, 1j * rows.stack.omega * rows.receptance)
    every = (swing[0].shape[1] - 1) // grid
    swing = (swing[0][:, :-1:every], swing[1][:, :-1:every])

    def wave(values: Complex128) -> Float64:
        return np.asarray(np.fft.irfft(values, grid, axis=1) * (grid / 2), dtype=np.float64)

    def spectrum(values: Float64) -> Complex128:
        return np.asarray(np.fft.rfft(values, axis=1)[:, :lines] * (2.0 / grid), dtype=np.complex128)

    def apart(u: _Change) -> Complex128:
        parts = zip(now.slopes, answer, swing, strict=True)
        return u.force + spectrum(_sum([f * (wave(a * u.force) - u.ends @ b) for f, a, b in parts]))

    def apart_back(w: Complex128) -> _Change:
        felt = [f * wave(w) for f in now.slopes]
        force = w + _sum([a.conj() * spectrum(f) for f, a in zip(felt, answer, strict=True)])
        return _Change(force, _sum([f @ b.T for f, b in zip(felt, swing, strict=True)]) * (-2.0 / grid))

    # Scaled by what the law's mean slope makes of it, forces and ends apart: then what is left of the right
    # side is what the sum of squares may still fall by.
    mean = _sum([f.mean(axis=1)[:, None] * a for f, a in zip(now.slopes, answer, strict=True)])
    own = (np.abs(rows.reach) ** 2).sum(axis=1) + np.abs(1.0 + mean) ** 2 / rows.power
    size = root / np.sqrt(own)
    flat = (rows.jumps * root[:, None, None]).reshape(-1, swing[0].shape[0])
    swung = spectrum(_sum([f.mean() * b for f, b in zip(now.slopes, swing, strict=True)]))
    swung = swung * root / np.sqrt(rows.power)
    tied = TIED * np.eye(flat.shape[1])
    lower = np.linalg.cholesky((flat.conj().T @ flat).real + (swung @ swung.conj().T).real + tied)
    eased = np.linalg.inv(lower)

    def pack(asked: _Change) -> Float64:
        scaled = asked.force * size
        return np.concatenate((scaled.real.ravel(), scaled.imag.ravel(), (asked.ends @ eased.T).ravel()))

    def unpack(values: Float64) -> _Change:
        half = count * lines
        force = (values[:half] + 1j * values[half : 2 * half]).reshape(count, lines) / np.sqrt(own) / root
        return _Change(force, values[2 * half :].reshape(count, -1) @ eased)

    def normal(values: Float64) -> Float64:
        u = unpack(values)
        return pack(rows.told_back(rows.told(u)).plus(apart_back(apart(u) / rows.power)))

    right = pack(rows.told_back(rows.left(change)).plus(apart_back(_apart(rows, change, now) / rows.power)))
    operator = LinearOperator((right.size, right.size), matvec=normal, dtype=float)
    found, _ = cg(operator, -right, rtol=TOLERANCE, atol=LEFT, maxiter=ITERATIONS)
    return unpack(found)
