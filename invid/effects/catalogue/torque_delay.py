"""The torque that acts lags the torque in the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment, PlaceMotion
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.motion import View
from invid.effects.parameter import Parameter
from invid.effects.sizes import LATE, Size, size
from invid.errors import InputError
from invid.model.parameters import ChainStructure
from invid.model.place import Place, axis_places
from invid.numerics.arrays import Complex128, Float64


class ActuatorEffect(Effect):
    """Acting torque = response(ω)·recorded torque."""

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure)

    def response(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        """(F,) acting over recorded torque."""
        raise NotImplementedError

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        out: Complex128 = np.zeros_like(view.acting)
        out[:, place.axis] = (1.0 - self.response(view, place, x)) * view.acting[:, place.axis]
        return out, None


class TorqueDelay(ActuatorEffect):
    """Acting torque(t) = recorded torque(t − delay); negative: leading."""

    cause = "torque_delay"
    title = "torque that acts later than the record says"
    check = "Check the drive's current loop, its filters and the timestamps of the torque it reports."
    separating = Experiment(
        "band", "a wider band: a delay's phase grows with frequency and its gain stays one"
    )
    family = "actuator_dynamics"
    looks_like = ("torque_lag",)
    home = "axis"
    over = "torque rate"
    sizes = (Size(LATE, size("delay")),)
    numbers = (Parameter("delay", "time", linear=False, logarithmic=False),)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        step = views[0].record.step
        return [(f * step,) for f in (-3.0, -1.0, 0.5, 1.0, 2.0, 4.0, 8.0)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        most = 0.5 / max(float(v.omega[-1]) / 2 / np.pi for v in views)
        most = max(most, 4 * views[0].record.step)
        return [(-most, most)]

    def response(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        out: Complex128 = np.exp(-1j * view.omega * x[0])
        return out

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["delay"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, delay=at.value("delay"))]

    def regressors(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        if motion.torque_rate is None:
            raise InputError("effect torque_delay: the torque's rate is not known")
        return motion.torque_rate[:, None]


class TorqueLag(ActuatorEffect):
    """time_constant·Ṫ + T = recorded torque."""

    cause = "torque_lag"
    title = "torque that follows the record through a first-order lag"
    check = "Check the bandwidth of the drive's current loop and its torque filters."
    separating = Experiment("band", "a wider band: a lag loses amplitude with frequency, a delay does not")
    family = "actuator_dynamics"
    looks_like = ("torque_delay",)
    home = "axis"
    over = "torque rate"
    sizes = (Size(LATE, size("time_constant")),)
    numbers = (Parameter("time_constant", "time", linear=False),)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        step = views[0].record.step
        return [(float(np.log(f * step)),) for f in (0.3, 0.7, 1.5, 3.0, 6.0, 12.0)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        step = views[0].record.step
        return [(float(np.log(0.05 * step)), float(np.log(100 * step)))]

    def response(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        out: Complex128 = 1.0 / (1.0 + 1j * view.omega * np.exp(x[0]))
        return out

    def noise_power(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[float | Float64, float | Float64]:
        # Or a lag that takes the torque's noise away would look like one that explains it.
        return 1.0, np.abs(self.response(view, place, x)) ** 2

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["time_constant"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, lag=at.positive("time_constant"))]
