"""Friction inside the transmission: a slider beside the spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Float64
from invid.effects.base import ForceEffect
from invid.effects.place import Place, spring_places
from invid.effects.slider import remembers, slide
from invid.effects.view import View, rms
from invid.refine.structure import ChainStructure


class SpringHysteresis(ForceEffect):
    """Torque stiffness·z beside the spring, |stiffness·z| ≤ torque."""

    cause = "spring_hysteresis"
    title = "friction inside the transmission (hysteresis of the spring)"
    check = "Check the gear's preload and lubrication; harmonic drives show it by nature."
    separate = "a second amplitude with the motor held: the loop's width does not grow with amplitude"
    family = "spring"
    parameters: ClassVar[Mapping[str, str]] = {"stiffness": "stiffness", "torque": "torque"}
    coefficients = ("torque",)
    lower, upper = (0.0,), (np.inf,)
    shapes, logarithmic = ("most",), (True,)
    main = "torque"

    def places(self, structure: ChainStructure) -> list[Place]:
        return spring_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(size * f)),) for f in (0.1, 0.25, 0.5, 1.0)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(1e-3 * size)), float(np.log(3.0 * size)))]

    def remembers(self, view: View, place: Place, x: Sequence[float]) -> bool:
        wave = view.wave(place.pattern(view.structure))
        return remembers(wave, float(np.exp(x[1])), periodic=not view.record.transient)

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        most = float(np.exp(shape[0]))
        d = view.wave(place.pattern(view.structure))
        start = view.starts.get(place.pattern(view.structure), 0.0)
        return slide(d, most, periodic=not view.record.transient, start=start)[:, None] / most

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"stiffness": float(x[0] / np.exp(x[1])), "torque": float(x[0])}
