"""The torque that acts follows the torque in the record through a first-order lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.parameter import Parameter
from invid.effects.sizes import LATE, Size, size
from invid.model.place import axis_places
from invid.numerics.arrays import Float64


class TorqueLag(Effect):
    """time_constant·Ṫ + T = recorded torque."""

    cause = "torque_lag"
    title = "torque that follows the record through a first-order lag"
    check = "Check the bandwidth of the drive's current loop and its torque filters."
    separating = Experiment("band", "a wider band: a lag loses amplitude with frequency, a delay does not")
    family = "actuator_dynamics"
    stands = (axis_places,)
    looks_like = ("torque_delay",)
    home = "axis"
    over = "torque rate"
    sizes = (Size(LATE, size("time_constant")),)
    numbers = (Parameter("time_constant", "time", linear=False),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["time_constant"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, lag=at.positive("time_constant"))]
