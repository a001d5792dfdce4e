"""A cause that is a law of the motion at its place: all that an effect in a file of its own has to declare.

The law alone is fitted, named, simulated, saved, reloaded and drawn, on elastic and on rigid machines
(docs/how-to/add-an-effect.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from invid.effects.effect import Effect, PlaceMotion
from invid.effects.elements import Element, ModelPlace, StaticLaw
from invid.effects.parameter import Parameter
from invid.effects.units import unit_of
from invid.numerics.arrays import Float64

OF_MOTION = ("velocity", "position", "deflection", "deflection rate")
"""Quantities over which a law can be simulated from a table."""
OF_RATE = ("velocity", "deflection rate")
"""Those of them that are rates."""
PAIRS = (("velocity", "position"), ("deflection", "deflection rate"))
"""Two of them that a law may depend on at once."""


class MotionEffect(Effect):
    """A resistance that follows from position, velocity and time at its place.

    A subclass gives ``cause``, ``title``, ``check``, ``family``, ``over``, ``numbers``, ``separating``,
    ``places`` and ``resistance``.
    """

    over = "velocity"

    def resistance(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        """(n, k) resistance for each linear parameter at one [N·m or N]; ``shape`` the others, in their
        units. What opposes the motion is positive."""
        raise NotImplementedError

    @property
    def linear(self) -> tuple[Parameter, ...]:
        """Parameters that its resistance is linear in."""
        return tuple(p for p in self.numbers if p.linear)

    @property
    def nonlinear(self) -> tuple[Parameter, ...]:
        """Parameters that are shapes."""
        return tuple(p for p in self.numbers if not p.linear)

    def starts(self, position: float, velocity: float) -> list[tuple[float, ...]]:
        """Starting shapes in their units for a motion of these rms sizes; [()] without shapes."""
        unit = {unit_of("velocity", False): velocity, unit_of("position", False): position}
        scaled = [
            tuple(s * (unit.get(unit_of(p.unit, False), 1.0) if p.of_motion else 1.0) for s in p.starts)
            for p in self.nonlinear
        ]
        return list(product(*scaled))

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64 | None:
        return self._static_resistance(p, x)

    def surface(self, p: Mapping[str, float], x: Float64, y: Float64) -> Float64:
        """(n,) resistance where ``over`` is ``x`` and ``across`` is ``y``, in pairs."""
        position, velocity = (y, x) if self.over in OF_RATE else (x, y)
        return self._resistance_at(p, PlaceMotion(position, velocity, np.zeros_like(x)))

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        p = {name: at.value(name) for name in self.parameters}
        a, b = at.coordinates(self.home)
        if self.across:
            surface = partial(self.surface, p)
            return [
                StaticLaw("both", (lambda q, v: surface(v, q)) if self.over in OF_RATE else surface, a, b)
            ]
        resistance = partial(self._static_resistance, p)
        return [StaticLaw("velocity" if self.over in OF_RATE else "position", resistance, a, b)]

    def _static_resistance(self, p: Mapping[str, float], x: Float64) -> Float64:
        """(n,) resistance where the quantity ``over`` is ``x`` and nothing else moves."""
        still = np.zeros_like(x)
        motion = PlaceMotion(x, still, still)
        if self.over in OF_RATE:
            motion = replace(motion, position=still, velocity=x)
        return self._resistance_at(p, motion)

    def _resistance_at(self, p: Mapping[str, float], motion: PlaceMotion) -> Float64:
        size = np.array([p[own.name] for own in self.linear])
        out: Float64 = self.resistance(motion, [p[own.name] for own in self.nonlinear]) @ size
        return out
