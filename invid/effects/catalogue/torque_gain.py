"""The torque channel of one axis is scaled wrongly, relative to the other axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect
from invid.effects.motion import View
from invid.model.parameters import ChainStructure
from invid.model.place import Place, axis_places
from invid.numerics.arrays import Complex128, Float64


class TorqueGain(Effect):
    """Acting torque = gain·recorded torque."""

    cause = "torque_gain"
    title = "a torque channel that is scaled wrongly"
    check = "Check the rated torque and torque constant in the drive's parameters."
    separate = "a known torque (a weight on a lever) on each axis"
    family = "scale"
    parameters: ClassVar[Mapping[str, str]] = {"gain": "ratio"}
    coefficients = ("gain",)
    lower, upper = (-0.95,), (20.0,)
    least_axes = 2
    main = "gain"

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure) if structure.motors > 1 else []

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        out: Complex128 = np.zeros((*view.acting.shape, 1), dtype=complex)
        out[:, place.axis, 0] = -view.acting[:, place.axis]
        return out

    def noise_power(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[float | Float64, float | Float64]:
        return 1.0, (1.0 + x[0]) ** 2

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"gain": 1.0 + float(x[0])}
