"""Friction of every motor, in the first hypothesis of every fit: laws of measured motion.

    f = (torque + rise·exp(−(u/v_s)²))·tanh(u/w) + viscous·v + offset,    u = v + T·v̇

w is the width over which dry friction turns round, v_s the Stribeck velocity, T the lead of the turn: a soft
contact that holds the motor bears its inertia as well, and turns before the motor does (MuJoCo's
``frictionloss`` by 10 ms).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np

from invid.likelihood.unknown_forces.stack import Stack
from invid.likelihood.unknown_forces.value import Column
from invid.model.plant import Structure
from invid.numerics.arrays import Complex128, Float64
from invid.signals.record import Record


class Part(Enum):
    """Parts of a motor's friction."""

    DRY = "dry"
    RISE = "rise"
    VISCOUS = "viscous"
    OFFSET = "offset"


@dataclass(frozen=True)
class FrictionShape:
    """Width of dry friction's turn and Stribeck velocity [rad/s or m/s], and the turn's lead [s]."""

    width: float
    stribeck: float
    lead: float = 0.0


WIDTH, STRIBECK = 0.0067, 0.13
"""First width and Stribeck velocity over the motor's rms velocity (empirical, whole cells)."""


def first_shapes(stacks: Sequence[Stack]) -> tuple[FrictionShape, ...]:
    """Shapes to start from, by each motor's speed; of one that stands by that of the fastest."""
    power = np.mean([(r.motion.velocity**2).mean(axis=0) for s in stacks for r in s.records], axis=0)
    speed = np.sqrt(np.where(power > 0.0, power, power.max()))
    return tuple(FrictionShape(WIDTH * float(v), STRIBECK * float(v)) for v in speed)


class MotorLaws:
    """Columns of the motors' friction, kept by shape: they depend on the records alone."""

    def __init__(self, stacks: Sequence[Stack]) -> None:
        self.stacks = tuple(stacks)
        self._lines: dict[tuple[int, Part, FrictionShape | None], tuple[Complex128, ...]] = {}

    def columns(self, structure: Structure, shapes: Sequence[FrictionShape]) -> tuple[Column, ...]:
        """The laws of every motor."""
        unit = np.eye(structure.coordinates)
        out = []
        for motor, shape in enumerate(shapes):
            for part in Part:
                out.append(
                    Column(
                        (part, motor),
                        unit[structure.motor[motor]],
                        self.lines(motor, part, shape),
                        partial(self.wide, motor, part, shape),
                        low=-np.inf if part is Part.OFFSET else 0.0,
                        damps=motor if part is Part.VISCOUS else -1,
                    )
                )
        return tuple(out)

    def lines(self, motor: int, part: Part, shape: FrictionShape) -> tuple[Complex128, ...]:
        """(R, F) of each stack."""
        shaped = {Part.DRY: replace(shape, stribeck=0.0), Part.RISE: shape}.get(part)
        key = (motor, part, shaped)
        if key not in self._lines:
            self._lines[key] = tuple(
                np.array([r.lines(_force_in(r, motor, part, shape)) for r in s.records]) for s in self.stacks
            )
        return self._lines[key]

    def wide(self, motor: int, part: Part, shape: FrictionShape, number: int) -> Complex128:
        """(R, A) of one stack on all its lines."""
        records = self.stacks[number].records
        return np.array([r.wide_lines(_force_in(r, motor, part, shape)) for r in records])


def _force_in(record: Record, motor: int, part: Part, shape: FrictionShape) -> Float64:
    motion = record.motion
    return force(part, motion.velocity[:, motor], shape, motion.acceleration[:, motor])


def force(
    part: Part, velocity: Float64, shape: FrictionShape, acceleration: Float64 | float = 0.0
) -> Float64:
    """(k,) of a part for a coefficient of one."""
    if part is Part.VISCOUS:
        return velocity
    if part is Part.OFFSET:
        return np.ones(velocity.size)
    held = velocity + shape.lead * acceleration
    turn: Float64 = np.tanh(held / shape.width)
    return turn if part is Part.DRY else np.exp(-((held / shape.stribeck) ** 2)) * turn
