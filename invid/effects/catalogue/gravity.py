"""Gravity: a sinusoid of the angle, one cycle a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.motion import View
from invid.model.parameters import ChainStructure
from invid.model.place import Place, end_places, motor_places
from invid.numerics.arrays import Float64


class Gravity(ForceEffect):
    """Resistance torque·sin(q + angle), q the position of the final mass, or of the motor."""

    cause = "gravity"
    title = "gravity on the load"
    check = "Give the controller the load's weight and centre of gravity; check the balancer."
    separate = "the same motion around positions far apart: gravity changes with position, an offset does not"
    family = "position"
    parameters: ClassVar[Mapping[str, str]] = {"torque": "torque", "angle": "angle"}
    coefficients = ("sine", "cosine")
    lower, upper = (-np.inf,) * 2, (np.inf,) * 2
    rotary = True
    main = "torque"

    def places(self, structure: ChainStructure) -> list[Place]:
        # A motor that carries weight itself (a counterweight, a pulley) before its springs.
        ends = end_places(structure)
        return [*ends, *(p for p in motor_places(structure) if p not in ends)]

    def rarity(self, place: Place, structure: ChainStructure) -> float:
        # Weight hangs on the load. One in twenty at the motor is a guess; slow motion does not tell the two.
        return 0.0 if place in end_places(structure) else float(2.0 * np.log(20.0))

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        q = view.wave(place.pattern(view.structure))
        return np.stack([np.sin(q), np.cos(q)], axis=1)

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(np.hypot(x[0], x[1])), "angle": float(np.arctan2(x[1], x[0]))}
