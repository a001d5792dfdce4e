"""Gravity on the load: a sinusoid of its angle, one cycle a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Float64
from invid.effects.base import ForceEffect, Place, View, end_places
from invid.refine.structure import ChainStructure


class Gravity(ForceEffect):
    """Resistance torque·sin(θ_load + angle)."""

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
        return end_places(structure)

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        q = view.wave(place.pattern(view.structure))
        return np.stack([np.sin(q), np.cos(q)], axis=1)

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(np.hypot(x[0], x[1])), "angle": float(np.arctan2(x[1], x[0]))}
