"""The torque that acts is cut off at a limit that the record does not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.parameter import Parameter
from invid.effects.sizes import RATED_SOURCE, SHORTFALL, Size, shortfall
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw
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


class TorqueSaturationLaw(SupposedLaw):
    """Torque beyond a limit does not act; shape ln(limit). Its coefficient is one."""

    effect, low = TorqueSaturation(), (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        limit = float(np.exp(shape[0]))
        torque = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return (torque - np.clip(torque, -limit, limit))[:, None]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(top * share)),) for share in (0.5, 0.65, 0.8, 0.9)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(0.2 * top)), float(np.log(0.98 * top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"limit": float(np.exp(shape[0]))}
