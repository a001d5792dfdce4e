"""Terms of what a fit has found, in the contract's terms: of every fit, friction at the motors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.identification.quantities import Quantities, axis_and_element
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.supposition import Supposed
from invid.likelihood.unknown_forces.worth import FRICTION
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

Sizes = dict[str, tuple[Callable[[Float64], float], list[int | None]]]
"""A cause's parameters: each a function of some of the values, and which."""


class TermWriter:
    """Terms of one fitted hypothesis."""

    def __init__(self, now: Supposed, axes: Sequence[str], *, linear: bool) -> None:
        self.now, self.axes, self.linear = now, tuple(axes), linear
        self.known = Quantities.of(now)
        self.structure = now.hypothesis.structure

    def _unit(self, cause: str, parameter: str) -> str | None:
        return unit_of(BY_CAUSE[cause].parameters.get(parameter, "ratio"), self.linear)

    def term(self, cause: str, axis: int, sizes: Sizes, **place: str) -> EffectTerm:
        """A cause's term, its parameters functions of what was fitted."""
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
        at = {part: self.known.coefficient((part, motor)) for part in parts | {Part.DRY}}
        dry, rise = at[Part.DRY], at.get(Part.RISE)
        found: dict[str, Sizes] = {}
        if rise is not None:  # at its bound, there is none to have a velocity
            velocity = self.known.shape((Part.DRY, motor, "stribeck"))
            found["stribeck_friction"] = {
                "static": (lambda v: float(v[0] + v[1]), [dry, rise]),
                "coulomb": (lambda v: float(v[0]), [dry]),
                "velocity": (lambda v: float(np.exp(v[0])), [velocity]),
            }
        for part, cause in reversed(FRICTION):
            if part in parts and part is not Part.RISE and not (part is Part.DRY and rise is not None):
                found[cause] = {BY_CAUSE[cause].main: (lambda v: float(v[0]), [at[part]])}
        return [self.term(cause, motor, sizes, element="mass 1") for cause, sizes in found.items()]
