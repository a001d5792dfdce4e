"""Motion of the motors that agrees with their friction.

Dry friction turns round within a velocity that the encoder's noise may be as large as, and while a motor
sticks it follows the law where that is steepest. What the encoder does not tell there the torque does. No
unknown force acts at the motors meanwhile, and ``alone`` none anywhere: what the law misses on motion that is
not yet right such forces take up, motion that agrees with them needs them, and the two hold each other. With
the motion θ = y + n of a reading y with noise of power C_θ, and missing torque r of covariance S without that
noise, a step of n minimises

    |n + δn|² by C_θ  +  |r + Z·δn + φ'·jω·δn|² by S,

φ' the slope of friction over time, all else on lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.likelihood.unknown_forces.motor_laws import FrictionShape, Part, force
from invid.likelihood.unknown_forces.smoother import SmoothedStack
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.newton_descent import descend, solve_normal
from invid.signals.record import Record

Friction = Sequence[tuple[FrictionShape, float, float]]
"""Shape, dry torque and rise at slow speed of every motor."""
DIFFERENCE = 0.05
"""Step of the velocity over the width of the turn for the slope of friction."""
WIDER = (27.0, 9.0, 3.0, 1.0)
"""Widths of the turn over its own at which motion is made to agree, one after another, where steps at the
narrow one lead nowhere."""
AGREES = 2.0
"""Cost over that of noise alone, one a row, up to which motion agrees (statistical: it scatters by less)."""
STANDING = 1e-6
"""Least noise of a reading in its record over the mean of all (numerical)."""


def agreed_records(stack: SmoothedStack, friction: Friction, *, alone: bool) -> tuple[Record, ...]:
    """The records of a stack with motor motion as readings, torque and friction together have it."""
    rows = _Rows.of(stack, friction, alone=alone)
    found = descend(_At.of(rows, np.zeros_like(rows.beyond)))
    if found.cost > AGREES * rows.beyond.size:
        there = _At.of(rows, np.zeros_like(rows.beyond))
        for wider in WIDER:
            there = descend(_At.of(rows.with_widths(wider), there.change))
        found = min(found, there, key=lambda at: at.cost)
    position, velocity = rows.waves(found.change)
    return tuple(
        replace(r, motion=replace(r.motion, position=r.motion.position + p, velocity=r.motion.velocity + v))
        for r, p, v in zip(stack.stack.records, position, velocity, strict=True)
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """``beyond`` (R, A, M): the readings less the records' motion; ``whitener`` (A, M, M) of S; ``deviation``
    (R, 1, M) of a reading's line in its own record: of a motor that stands the torque tells no motion."""

    stack: SmoothedStack
    friction: Friction
    beyond: Complex128
    whitener: Complex128
    deviation: Float64
    still: Complex128

    @classmethod
    def of(cls, stack: SmoothedStack, friction: Friction, *, alone: bool) -> _Rows:
        noise = stack.stack.position_noise
        beyond = np.array([r.position - r.wide_lines(r.motion.position) for r in stack.stack.records])
        power = stack.noise.power.copy()
        power[:, : power.shape[1] if alone else noise.size] = 0.0  # the motors are the first places
        whitener = stack.noise_of(power, np.zeros(noise.size)).whitener
        own = np.array([[r.position_noise] for r in stack.stack.records])
        deviation = np.sqrt(np.maximum(np.maximum(own, STANDING * noise), 1e-300))
        rows = cls(stack, friction, beyond, whitener, deviation, np.zeros_like(beyond))
        return replace(rows, still=rows.lines([r.motion.velocity for r in stack.stack.records]))

    def with_widths(self, wider: float) -> _Rows:
        """The same with dry friction that turns round over so many times its width."""
        friction = [(replace(s, width=wider * s.width), dry, rise) for s, dry, rise in self.friction]
        return replace(self, friction=friction, still=self.still)

    def waves(self, change: Complex128) -> tuple[Float64, Float64]:
        """(R, k + 1, M) position and velocity of a change (R, A, M) over time."""
        stack, turned = self.stack, change.transpose(0, 2, 1)
        position, velocity = stack.wave(turned), stack.wave(1j * stack.omega * turned)
        return position.transpose(0, 2, 1), velocity.transpose(0, 2, 1)

    def lines(self, velocity: Sequence[Float64]) -> Complex128:
        """(R, A, M) friction that turns with the velocity (k + 1, M) of each record."""
        records = self.stack.stack.records
        return np.array([r.wide_lines(self.turn(v)) for r, v in zip(records, velocity, strict=True)])

    def turn(self, velocity: Float64) -> Float64:
        """(k, M) friction that turns with the velocity."""
        parts = [
            dry * force(Part.DRY, v, shape) + rise * force(Part.RISE, v, shape)
            for v, (shape, dry, rise) in zip(velocity.T, self.friction, strict=True)
        ]
        return np.stack(parts, axis=1)

    def slope(self, velocity: Float64) -> Float64:
        """(k, M) its derivative by the velocity."""
        step = DIFFERENCE * np.array([shape.width for shape, _, _ in self.friction])
        out: Float64 = (self.turn(velocity + step) - self.turn(velocity - step)) / (2.0 * step)
        return out


@dataclass(frozen=True, eq=False)
class _At:
    """Motion ``change`` (R, A, M) beyond the records', with the ``velocity`` (k + 1, M) of each: whitened
    missing torque and noise of the readings (R, A, M)."""

    rows: _Rows
    change: Complex128
    velocity: tuple[Float64, ...]
    missing: Complex128
    noise: Complex128

    @classmethod
    def of(cls, rows: _Rows, change: Complex128) -> _At:
        stack = rows.stack
        more = rows.waves(change)[1]
        velocity = [r.motion.velocity + v for r, v in zip(stack.stack.records, more, strict=True)]
        away = change - rows.beyond
        missing = stack.missing + (stack.condensed.stiffness @ away[..., None])[..., 0]
        missing = missing + rows.lines(velocity) - rows.still
        white = (rows.whitener @ missing[..., None])[..., 0]
        return cls(rows, change, tuple(velocity), white, away / rows.deviation)

    @cached_property
    def slope(self) -> Float64:
        """(R, M, k) slope of friction on the coarse grid."""
        every = slice(None, -1, self.rows.stack.stride)
        return np.array([self.rows.slope(v[every]).T for v in self.velocity])

    @cached_property
    def cost(self) -> float:
        told = (np.abs(self.missing) ** 2 + np.abs(self.noise) ** 2).sum(axis=2)
        return float((told * self.rows.stack.weight).sum())

    def moved(self, step: Float64) -> _At:
        return _At.of(self.rows, self.change + self._unpack(step))

    def step(self) -> Float64:
        deviation = self.rows.deviation

        def normal(values: Float64) -> Float64:
            u = self._unpack(values)
            return self._pack(self._felt_back(self._felt(u)) + u / deviation**2)

        return solve_normal(normal, -self._pack(self._felt_back(self.missing) + self.noise / deviation))

    def _felt(self, u: Complex128) -> Complex128:
        """(R, A, M) whitened torque of a change of motion."""
        stack, turned = self.rows.stack, u.transpose(0, 2, 1)
        lost = stack.coarse_lines(self.slope * stack.coarse_wave(1j * stack.omega * turned))
        pushed = (stack.condensed.stiffness @ u[..., None])[..., 0] + lost.transpose(0, 2, 1)
        return np.asarray((self.rows.whitener @ pushed[..., None])[..., 0], dtype=np.complex128)

    def _felt_back(self, w: Complex128) -> Complex128:
        stack = self.rows.stack
        pulled = (self.rows.whitener.conj().transpose(0, 2, 1) @ w[..., None])[..., 0]
        lost = stack.coarse_lines(self.slope * stack.coarse_wave(pulled.transpose(0, 2, 1)))
        back = (stack.condensed.stiffness.conj().transpose(0, 2, 1) @ pulled[..., None])[..., 0]
        return np.asarray(back + (-1j * stack.omega * lost).transpose(0, 2, 1), dtype=np.complex128)

    @cached_property
    def _scale(self) -> Float64:
        """(R, A, M) root of the diagonal that friction's mean slope makes."""
        stack, mean = self.rows.stack, self.slope.mean(axis=(0, 2))
        rubbed = stack.condensed.stiffness + (1j * stack.omega)[:, None, None] * np.diag(mean)
        own = (np.abs(self.rows.whitener @ rubbed) ** 2).sum(axis=1) + 1.0 / self.rows.deviation**2
        return np.asarray(np.sqrt(own), dtype=np.float64)

    def _pack(self, pull: Complex128) -> Float64:
        scaled = pull * np.sqrt(self.rows.stack.weight)[:, None] / self._scale
        return np.concatenate((scaled.real.ravel(), scaled.imag.ravel()))

    def _unpack(self, values: Float64) -> Complex128:
        half = values.size // 2
        change = (values[:half] + 1j * values[half:]).reshape(self.change.shape)
        root = np.sqrt(self.rows.stack.weight)[:, None]
        return np.asarray(change / self._scale / root, dtype=np.complex128)
