"""From a fitted hypothesis to the contract's terms: causes at their places with sizes and deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from invid.diagnosis.unknown_forces.structures import Addition, Mode, base_of
from invid.effects.laws.moving_base import SHARE
from invid.identification.quantities import axis_and_element
from invid.identification.terms import Sizes, TermWriter
from invid.likelihood.unknown_forces.forces import Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.document import EffectTerm, Estimate
from invid.model.plant import Kind
from invid.numerics.arrays import Float64


class CauseWriter(TermWriter):
    """Terms of every cause of one fitted hypothesis."""

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
        term = self.term(placed.law.cause, axis, sizes, element=element)
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
        return self.term(mode.cause, axis, sizes, element=f"mass {host - structure.motor[axis] + 1}")

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
        return self.term(cause, 0, sizes)
