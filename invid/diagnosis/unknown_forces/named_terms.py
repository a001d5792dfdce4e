"""From a fitted hypothesis to the contract's terms: causes at their places with sizes and deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.unknown_forces.structures import Addition, Mode, base_of
from invid.effects.laws.moving_base import SHARE
from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.plant import Kind, Structure
from invid.likelihood.unknown_forces.shapes import Curvature, curvature
from invid.likelihood.unknown_forces.supposition import Channel, PlacedLaw, Supposed
from invid.likelihood.unknown_forces.timing import COMMAND, EXPECTED_DELAY, HOLD
from invid.model.document import EffectTerm, Estimate
from invid.numerics.arrays import Float64

Sizes = dict[str, tuple[Callable[[Float64], float], list[int | None]]]
"""A cause's parameters: each a function of some of the values, and which."""
STEP = 1e-4
"""Relative step of the differences by which deviations pass to a cause's own parameters."""


@dataclass(frozen=True, eq=False)
class Quantities:
    """Everything that a fit has found as one vector with its covariance, looked up by name."""

    now: Supposed
    around: Curvature

    @classmethod
    def of(cls, now: Supposed) -> Quantities:
        """At a fit."""
        return cls(now, curvature(now))

    def coefficient(self, name: object) -> int | None:
        """Index of a law's coefficient; ``None`` where it is at a bound."""
        at = [c.name for c in self.now.fit.problem.columns].index(name)
        where = np.flatnonzero(self.around.free == at)
        return self.around.numbers + int(where[0]) if where.size else None

    def fitted(self, name: object) -> float:
        """A law's coefficient."""
        names = [c.name for c in self.now.fit.problem.columns]
        return float(self.now.fit.value.coefficients[names.index(name)])

    def shape(self, name: object) -> int:
        """Index of a shape."""
        names = [s.name for s in self.around.shapes]
        return self.around.numbers + self.around.free.size + names.index(name)

    @property
    def values(self) -> Float64:
        """All values in the order of the covariance."""
        coefficients = self.now.fit.value.coefficients[self.around.free]
        shapes = [s.get(self.now.hypothesis) for s in self.around.shapes]
        return np.concatenate((self.now.numbers.x, coefficients, shapes))

    def estimate(
        self, size: Callable[[Float64], float], indices: Sequence[int | None], unit: str | None
    ) -> Estimate:
        """A function of some of the values, with its deviation to first order; absent ones are zero."""
        known = [k for k in indices if k is not None]
        values = self.values[known]
        place = [i for i, k in enumerate(indices) if k is not None]

        def at(moved: Float64) -> float:
            full = np.zeros(len(indices))
            full[place] = moved
            return size(full)

        slope = np.zeros(len(known))
        for i, value in enumerate(values):
            step = STEP * max(abs(float(value)), 1e-6)
            up, down = values.copy(), values.copy()
            up[i] += step
            down[i] -= step
            slope[i] = (at(up) - at(down)) / (2 * step)
        block = self.around.covariance[np.ix_(known, known)]
        deviation = float(np.sqrt(max(float(slope @ block @ slope), 0.0)))
        return Estimate(float(at(values)), deviation if np.isfinite(deviation) else None, unit)


def axis_and_element(structure: Structure, spot: Spot) -> tuple[int, str]:
    """Axis and the contract's element of a place."""
    if spot.where is Where.MOTOR:
        return spot.number, "mass 1"
    first = structure.links[spot.number][0] if spot.where is Where.SPRING else spot.number
    axis = structure.axis_of(first)
    if first >= sum(structure.sizes):
        return axis, "base" if first - sum(structure.sizes) == len(structure.modes) else "mode"
    number = first - structure.motor[axis] + 1
    return axis, f"{'spring' if spot.where is Where.SPRING else 'mass'} {number}"


class TermWriter:
    """Terms of one fitted hypothesis."""

    def __init__(self, now: Supposed, axes: Sequence[str], *, linear: bool) -> None:
        self.now, self.axes, self.linear = now, tuple(axes), linear
        self.known = Quantities.of(now)
        self.structure = now.hypothesis.structure

    def _unit(self, cause: str, parameter: str) -> str | None:
        return unit_of(BY_CAUSE[cause].parameters.get(parameter, "ratio"), self.linear)

    def _term(
        self,
        cause: str,
        axis: int,
        sizes: Sizes,
        **place: str,
    ) -> EffectTerm:
        parameters = {
            name: self.known.estimate(size, indices, self._unit(cause, name))
            for name, (size, indices) in sizes.items()
        }
        return EffectTerm(cause, self.axes[axis], parameters, place.get("element"), place.get("other_axis"))

    def friction(self, motor: int, parts: frozenset[Part]) -> list[EffectTerm]:
        """Terms of a motor's friction for the parts that stay."""
        named = {
            Part(part)
            for placed in self.now.hypothesis.laws
            if axis_and_element(self.structure, placed.spot)[0] == motor
            for part in placed.law.beside
        }
        parts = parts - named
        dry, rise, viscous = (self.known.coefficient((p, motor)) for p in (Part.DRY, Part.RISE, Part.VISCOUS))
        out = []
        if Part.RISE in parts:
            velocity = self.known.shape((Part.DRY, motor, "stribeck"))
            sizes: Sizes = {
                "static": (lambda v: float(v[0] + v[1]), [dry, rise]),
                "coulomb": (lambda v: float(v[0]), [dry]),
                "velocity": (lambda v: float(np.exp(v[0])), [velocity]),
            }
            out.append(self._term("stribeck_friction", motor, sizes, element="mass 1"))
        elif Part.DRY in parts:
            out.append(
                self._term("coulomb_friction", motor, {"torque": (lambda v: v[0], [dry])}, element="mass 1")
            )
        if Part.VISCOUS in parts:
            sizes = {"coefficient": (lambda v: v[0], [viscous])}
            out.append(self._term("viscous_friction", motor, sizes, element="mass 1"))
        if Part.OFFSET in parts:
            offset = self.known.coefficient((Part.OFFSET, motor))
            out.append(
                self._term("torque_offset", motor, {"torque": (lambda v: v[0], [offset])}, element="mass 1")
            )
        return out

    def law(self, placed: PlacedLaw) -> EffectTerm:
        """Term of a law."""
        number = self.now.hypothesis.laws.index(placed)
        axis, element = axis_and_element(self.structure, placed.spot)
        indices = [self.known.coefficient((*placed.key, i)) for i in range(len(placed.law.low))]
        indices += [self.known.coefficient((Part(part), axis)) for part in placed.law.beside]
        count = len(indices)
        at_bound = np.zeros(count)
        for i in range(len(placed.law.low)):
            if indices[i] is None:
                at_bound[i] = self.known.fitted((*placed.key, i))
        shapes = [self.known.shape((number, i)) for i in range(len(placed.shape))]
        stiffness = 1.0
        if placed.spot.where is Where.SPRING:
            stiffness = float(self.now.numbers.plant.of_kind(Kind.SPRING)[placed.spot.number])

        def size(name: str) -> Callable[[Float64], float]:
            return lambda v: placed.law.parameters(v[:count] + at_bound, tuple(v[count:]), stiffness)[name]

        names = placed.law.parameters(np.ones(count), placed.shape, stiffness)
        sizes = {name: (size(name), [*indices, *shapes]) for name in names}
        term = self._term(placed.law.cause, axis, sizes, element=element)
        if not placed.law.counts:
            return term
        counted = Estimate(float(element.split()[-1]), None, self._unit(placed.law.cause, placed.law.counts))
        return replace(term, parameters={placed.law.counts: counted, **term.parameters})

    def addition(self, addition: Addition) -> EffectTerm:
        """Term of what the structure has besides its chains."""
        return self._mode(addition) if isinstance(addition, Mode) else self._base(addition.cause)

    def _mode(self, mode: Mode) -> EffectTerm:
        structure = self.structure
        host, at = mode.ends(structure)
        link = structure.links.index((host, at))
        mass, spring, damper = (
            structure.index(kind).start + number
            for kind, number in ((Kind.MASS, at), (Kind.SPRING, link), (Kind.DAMPER, link))
        )
        sizes: Sizes = {
            "mass": (lambda v: float(np.exp(v[0])), [mass]),
            "stiffness": (lambda v: float(np.exp(v[0])), [spring]),
            "damping_ratio": (
                lambda v: 0.5 * float(np.exp(v[2] - 0.5 * (v[0] + v[1]))),
                [mass, spring, damper],
            ),
        }
        axis = structure.axis_of(host)
        return self._term(mode.cause, axis, sizes, element=f"mass {host - structure.motor[axis] + 1}")

    def _base(self, cause: str) -> EffectTerm:
        plant, structure = self.now.numbers.plant, self.structure
        known = list(range(plant.x.size))

        def of(size: Callable[[dict[str, float], Float64], float]) -> Callable[[Float64], float]:
            return lambda v: size(*base_of(structure, plant.moved(v).values))

        def part(name: str) -> Callable[[Float64], float]:
            return of(lambda own, _: own[name])

        def share(axis: int) -> Callable[[Float64], float]:
            return of(lambda _, shares: float(shares[axis]))

        sizes: Sizes = {name: (part(name), [*known]) for name in ("mass", "stiffness", "damping_ratio")}
        sizes |= {f"{SHARE}{i + 1}": (share(i), [*known]) for i in range(structure.motors)}
        return self._term(cause, 0, sizes)

    def load_spring(self, pair: tuple[int, int]) -> EffectTerm:
        """Term of a spring between two loads."""
        at = self.structure.index(Kind.LOAD_SPRING).start + self.structure.pairs.index(pair)
        unit = self.now.numbers.plant.unit[at]
        sizes = {"stiffness": (lambda v: v[0] * unit, [at])}
        element = f"mass {self.structure.sizes[pair[0]]}"
        return self._term(
            "coupling_stiffness", pair[0], sizes, element=element, other_axis=self.axes[pair[1]]
        )

    def channel(self, channel: Channel, axis: int) -> EffectTerm:
        """Term of a drive that is late or lags."""
        first, motors = self.now.numbers.plant.x.size, self.structure.motors
        step = self.now.numbers.timing.step
        if channel is Channel.LAG:
            at = first + 4 * motors + axis
            return self._term(channel.value, axis, {"time_constant": (lambda v: v[0] * step, [at])})
        driven = any(r.driven[axis] for s in self.now.bench.stacks for r in s.records)
        at = first + (axis if driven else motors + axis)
        usual, open_part = self._usual_delay(axis) if driven else (EXPECTED_DELAY[HOLD], 0.0)
        term = self._term(channel.value, axis, {"delay": (lambda v: (v[0] - usual) * step, [at])})
        known = term.parameters["delay"]
        std = None if known.std is None else float(np.hypot(known.std, open_part * step))
        return replace(term, parameters={"delay": replace(known, std=std)})

    def _usual_delay(self, axis: int) -> tuple[float, float]:
        """Delay of a punctual command in this record [samples], and its deviation: that of the other axes.

        On one axis alone nothing tells whether samples show the command that begins or the one that ended.
        """
        late = {a for _, a in self.now.hypothesis.channels} | {axis}
        others = [float(d) for a, d in enumerate(self.now.numbers.timing.delay[COMMAND]) if a not in late]
        return (float(np.median(others)), 0.0) if others else (0.0, 1.0 / np.sqrt(12.0))
