"""The torque that acts lags the torque in the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.parameter import Parameter
from invid.effects.sizes import LATE, Size, size
from invid.model.place import axis_places
from invid.numerics.arrays import Float64


class TorqueDelay(Effect):
    """Acting torque(t) = recorded torque(t − delay); negative: leading."""

    cause = "torque_delay"
    title = "torque that acts later than the record says"
    check = "Check the drive's current loop, its filters and the timestamps of the torque it reports."
    separating = Experiment(
        "band", "a wider band: a delay's phase grows with frequency and its gain stays one"
    )
    family = "actuator_dynamics"
    stands = (axis_places,)
    looks_like = ("torque_lag",)
    home = "axis"
    over = "torque rate"
    sizes = (Size(LATE, size("delay")),)
    numbers = (Parameter("delay", "time", linear=False, logarithmic=False),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["delay"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, delay=at.value("delay"))]
