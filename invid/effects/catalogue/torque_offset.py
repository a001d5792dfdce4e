"""A constant torque: a sensor's offset, a preload, a cable that pulls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.motion import View
from invid.model.parameters import ChainStructure
from invid.model.place import Place, motor_places
from invid.numerics.arrays import Float64


class TorqueOffset(ForceEffect):
    """Resistance that does not change."""

    cause = "torque_offset"
    title = "a constant torque"
    check = "Check the current sensor's offset, cables and hoses that pull, and a balancer."
    separate = "the same motion around positions far apart: gravity changes with position, an offset does not"
    family = "constant"
    parameters: ClassVar[Mapping[str, str]] = {"torque": "torque"}
    coefficients = ("torque",)
    lower, upper = (-np.inf,), (np.inf,)
    main = "torque"

    def places(self, structure: ChainStructure) -> list[Place]:
        return motor_places(structure)

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        return np.ones((view.record.samples, 1))

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(x[0])}
