"""A constant torque: a sensor's offset, a preload, a cable that pulls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import OFFSET, Size, share
from invid.model.place import motor_places
from invid.numerics.arrays import Float64


class TorqueOffset(Effect):
    """Resistance that does not change."""

    cause = "torque_offset"
    title = "a constant torque"
    check = "Check the current sensor's offset, cables and hoses that pull, and a balancer."
    separating = Experiment(
        "positions",
        "the same motion around positions far apart: gravity changes with position, an offset does not",
    )
    family = "constant"
    stands = (motor_places,)
    looks_like = ("gravity", "asymmetric_friction")
    over = "velocity"
    sizes = (Size(OFFSET, share("torque")),)
    numbers = (Parameter("torque", "torque"),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return np.full_like(x, p["torque"])

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [ForceLaw(Law.CONSTANT, at.mass(), -1, (at.value("torque"),))]
