"""Friction inside the transmission: a slider beside the spring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.laws.slider import SliderEffect
from invid.effects.motion import View, rms
from invid.model.parameters import ChainStructure
from invid.model.place import Place, spring_places


class SpringHysteresis(SliderEffect):
    """Torque stiffness·z beside the spring, |stiffness·z| ≤ torque."""

    cause = "spring_hysteresis"
    title = "friction inside the transmission (hysteresis of the spring)"
    check = "Check the gear's preload and lubrication; harmonic drives show it by nature."
    separate = "a second amplitude with the motor held: the loop's width does not grow with amplitude"
    family = "spring"

    def places(self, structure: ChainStructure) -> list[Place]:
        return spring_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(size * f)),) for f in (0.1, 0.25, 0.5, 1.0)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(1e-3 * size)), float(np.log(3.0 * size)))]
