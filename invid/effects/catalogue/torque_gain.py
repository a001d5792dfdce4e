"""The torque channel of one axis is scaled wrongly, relative to the other axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.parameter import Parameter
from invid.effects.sizes import CONSTANT_SOURCE, SCALE, Size, scale_error
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw
from invid.model.place import Place, axis_places
from invid.model.plant import Structure
from invid.numerics.arrays import Float64
from invid.wording.sentence import sentence


class TorqueGain(Effect):
    """Acting torque = gain·recorded torque."""

    cause = "torque_gain"
    title = "a torque channel that is scaled wrongly"
    check = "Check the rated torque and torque constant in the drive's parameters."
    separating = Experiment(
        "hand",
        "a known torque (a weight on a lever) on each axis",
        by_hand="hang a known weight on a lever and compare the torque; no motion shows it.",
    )
    family = "scale"
    looks_like = ("torque_saturation", "encoder_eccentricity")
    home = "axis"
    over = "torque"
    sizes = (Size(SCALE, scale_error, 0.10, 0.20, CONSTANT_SOURCE),)
    numbers = (Parameter("gain", "ratio", low=-0.95, high=20.0),)

    def places(self, structure: Structure) -> list[Place]:
        return axis_places(structure) if structure.motors > 1 else []

    def size_text(self, size: str) -> str:
        return sentence(" (true torque is {size} times the record)", size=size)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return (1.0 - p["gain"]) * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, gain=at.value("gain"))]


class TorqueGainLaw(SupposedLaw):
    """More or less torque acts than is recorded, by a share of it."""

    effect = TorqueGain()
    scales = True

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return np.zeros((motion.position.size, 1))

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(-0.5, 1.0)]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gain": 1.0 + float(coefficients[0])}
