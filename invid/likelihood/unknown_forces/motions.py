"""Motion at every place of a machine: of motors as measured, elsewhere as smoothed at a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.likelihood.unknown_forces.consistent_motion import LawOfMotion, agree
from invid.likelihood.unknown_forces.correspondence import Correspondence
from invid.likelihood.unknown_forces.forces import Spot, Spots, Where
from invid.likelihood.unknown_forces.smoother import SmoothedStack, smooth
from invid.likelihood.unknown_forces.stack import Stack
from invid.likelihood.unknown_forces.value import Problem, Value
from invid.model.plant import Kind, Structure
from invid.numerics.arrays import Complex128, Float64


@dataclass(frozen=True, eq=False)
class PlacedLaw:
    """A law at a place with its shape."""

    law: SupposedLaw
    spot: Spot
    shape: Shape = ()
    number: int = 0
    """Of several of its kind at one place."""

    @property
    def key(self) -> tuple[str, Spot, int]:
        """What may stand once."""
        return self.law.cause, self.spot, self.number

    @property
    def needs_fit(self) -> bool:
        """Whether its waves are on motion that a fit has said."""
        return self.spot.where is not Where.MOTOR or self.law.reads


class Motions:
    """Motion at every place of a machine: of motors as measured, elsewhere as smoothed at a fit;
    ``is_agreed``: across springs in agreement with their laws."""

    def __init__(
        self,
        stacks: Sequence[Stack],
        structure: Structure,
        smoothed: Sequence[SmoothedStack] = (),
        *,
        is_agreed: bool = False,
    ) -> None:
        self.stacks, self.structure, self.smoothed = tuple(stacks), structure, tuple(smoothed)
        self.is_agreed = is_agreed
        self._known: dict[Spot, list[list[SpotMotion]]] = {}
        self.lines: dict[tuple[SupposedLaw, Spot, Shape, int], list[Complex128]] = {}

    def renewed(
        self, problem: Problem, value: Value, laws: Sequence[PlacedLaw], *, agreed: bool = False
    ) -> Motions:
        """Smoothed at a fit, motors where ``laws`` of their readings say that they stand; ``agreed``: springs
        where the laws of their motion do, which from far away may come to rest elsewhere."""
        structure = value.numbers.plant.structure
        out = Motions(self.stacks, structure, smooth(problem, value), is_agreed=agreed)
        names = [c.name for c in problem.columns]
        sized = [
            (p, value.coefficients[names.index((*p.key, 0)) :][: len(p.law.low)])
            for p in laws
            if agreed and p.spot.where is Where.SPRING
        ]
        for spot in dict.fromkeys(p.spot for p, _ in sized):
            number = problem.spots.number[spot]
            out = out._agreed((spot, number), [(p, c) for p, c in sized if p.spot == spot], self)
        for placed in laws:
            if placed.law.reads:
                own = [names.index((*placed.key, i)) for i in range(len(placed.law.low))]
                out._known[placed.spot] = [
                    [
                        _standing(new, placed.law.waves(old, placed.shape) @ value.coefficients[own])
                        for new, old in zip(*stack, strict=True)
                    ]
                    for stack in zip(out.of(placed.spot), self.of(placed.spot), strict=True)
                ]
        return out

    def on(self, stacks: Sequence[Stack]) -> Motions:
        """The same behind motors that move as in the records of other stacks."""
        out = Motions(stacks, self.structure, self.smoothed, is_agreed=self.is_agreed)
        out._known = {spot: m for spot, m in self._known.items() if spot.where is not Where.MOTOR}
        return out

    def _agreed(
        self, at: tuple[Spot, int], laws: Sequence[tuple[PlacedLaw, Float64]], was: Motions
    ) -> Motions:
        """The same where the motion at a place agrees with its laws of such coefficients, which a fit took on
        the motion that it ``was``."""

        def resistance(motion: SpotMotion) -> Float64:
            waves = [p.law.waves(motion, p.shape) @ value for p, value in laws]
            return np.asarray(np.sum(waves, axis=0), dtype=np.float64)

        (spot, number), vector, smoothed = at, vector_of(self.structure, at[0]), []
        is_smooth = all(p.law.is_smooth for p, _ in laws)
        for k, (stack, before) in enumerate(zip(self.smoothed, was.of(spot), strict=True)):
            now, record = self._of_stack(spot, k), stack.stack.records[0]
            most = min(p.law.stride(now[0], p.shape) if p.law.is_smooth else 1 for p, _ in laws)
            agreed = was.smoothed[k] if was.is_agreed and was.smoothed else None
            law = LawOfMotion(resistance, now, before, agreed, record.stride(most), is_smooth)
            smoothed.append(agree(stack, number, vector, law))
        return Motions(self.stacks, self.structure, smoothed, is_agreed=True)

    def in_structure(self, moved: Correspondence) -> Motions:
        """The same for another structure, at the places that both have."""
        out = Motions(self.stacks, moved.new, is_agreed=self.is_agreed)
        for spot, motion in self._all_known().items():
            at = moved.spot(spot)
            if at is not None:
                out._known[at] = motion
        for (law, spot, shape, quick), lines in self.lines.items():
            at = moved.spot(spot)
            if at is not None:
                out.lines[law, at, shape, quick] = lines
        return out

    def _all_known(self) -> dict[Spot, list[list[SpotMotion]]]:
        if self.smoothed:
            for spot in Spots.of(self.structure).spots:
                if spot.where in (Where.MASS, Where.SPRING):
                    self.of(spot)
        return dict(self._known)

    def of(self, spot: Spot) -> list[list[SpotMotion]]:
        """Motion in each record of each stack."""
        if spot not in self._known:
            self._known[spot] = [self._of_stack(spot, k) for k in range(len(self.stacks))]
        return self._known[spot]

    def flat(self, spot: Spot) -> list[SpotMotion]:
        """Motion in all records."""
        return [m for stack in self.of(spot) for m in stack]

    def readings(self, motor: Spot) -> list[Float64]:
        """Position of a motor in all records, as read."""
        return [r.motion.position[:, motor.number] for stack in self.stacks for r in stack.records]

    def rounding(self, motor: Spot) -> list[Complex128]:
        """(R, F) of each stack: reading of a motor less its motion, which is smooth. An error of the reading
        stretches both."""
        return [
            stack.position[..., motor.number]
            - np.array([r.lines(r.motion.position[:, motor.number]) for r in stack.records])
            for stack in self.stacks
        ]

    def _of_stack(self, spot: Spot, number: int) -> list[SpotMotion]:
        records = self.stacks[number].records
        clocks: list[Float64] = [
            r.start + r.motion.step * np.arange(r.motion.position.shape[0], dtype=np.float64) for r in records
        ]
        if spot.where is Where.MOTOR:
            i = spot.number
            own = None
            if self.smoothed:
                own = float(self.smoothed[number].plant.of_kind(Kind.MASS)[self.structure.motor[i]])
            out = []
            for r, clock in zip(records, clocks, strict=True):
                q, v = r.motion.position[:, i], r.motion.velocity[:, i]
                torque = np.interp(
                    clock - r.start, np.arange(r.torque_wave.shape[0]) * r.step, r.torque_wave[:, i]
                )
                out.append(SpotMotion(q, v, q, clock, torque, own, r.origin, r.periods > 1))
            return out
        vector = vector_of(self.structure, spot)
        unit = np.eye(self.structure.coordinates)
        first = self.structure.links[spot.number][0] if spot.where is Where.SPRING else int(np.argmax(vector))
        position, velocity = self.smoothed[number].over_time(vector)
        angle = self.smoothed[number].over_time(unit[first])[0]
        kind = {Where.SPRING: Kind.SPRING, Where.MASS: Kind.MASS}.get(spot.where)
        own = None if kind is None else float(self.smoothed[number].plant.of_kind(kind)[spot.number])
        return [
            SpotMotion(q, v, a, t, own=own, origin=r.origin, repeats=r.periods > 1)
            for q, v, a, t, r in zip(position, velocity, angle, clocks, records, strict=True)
        ]


def _standing(reading: SpotMotion, beyond: Float64) -> SpotMotion:
    """The motion of a motor that stands ``beyond`` (k,) its reading."""
    position = reading.position + beyond
    rate = np.gradient(beyond, reading.time[1] - reading.time[0])
    return replace(reading, position=position, angle=position, velocity=reading.velocity + rate)


def axis_of(structure: Structure, spot: Spot) -> int:
    """The axis of a place, of two loads the first."""
    if spot.where in (Where.MOTOR, Where.PAIR):
        return spot.number
    return structure.axis_of(structure.links[spot.number][0] if spot.where is Where.SPRING else spot.number)


def vector_of(structure: Structure, spot: Spot) -> Float64:
    """(n,) coordinates that a force at a place acts on."""
    spots = Spots.of(structure)
    out: Float64 = spots.vectors[:, spots.number[spot]]
    return out
