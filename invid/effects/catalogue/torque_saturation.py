"""The torque that acts is cut off at a limit that the record does not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.parameter import Parameter
from invid.effects.sizes import RATED_SOURCE, SHORTFALL, Size, shortfall
from invid.model.place import axis_places
from invid.numerics.arrays import Float64


class TorqueSaturation(Effect):
    """Acting torque = recorded torque within ±limit."""

    cause = "torque_saturation"
    title = "torque that is cut off at a limit"
    check = "Check the drive's current and torque limits and its bus voltage."
    separating = Experiment("amplitudes", "a second amplitude: below the limit nothing is missing")
    family = "saturation"
    stands = (axis_places,)
    looks_like = ("torque_gain",)
    home = "axis"
    over = "torque"
    sizes = (Size(SHORTFALL, shortfall, 0.0, 0.0, RATED_SOURCE, linear=True),)
    numbers = (Parameter("limit", "torque", linear=False),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = x - np.clip(x, -p["limit"], p["limit"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, limit=abs(at.value("limit")))]
