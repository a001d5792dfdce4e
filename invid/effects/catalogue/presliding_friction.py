"""Presliding: the contact gives elastically before it slides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.laws.slider import SliderEffect
from invid.effects.motion import View, rms
from invid.effects.sizes import FRICTION, JOINT_SOURCE, Size, share
from invid.model.parameters import ChainStructure
from invid.model.place import Place, mass_places


class PreslidingFriction(SliderEffect):
    """Resistance stiffness·z with z the slider's displacement, |stiffness·z| ≤ torque."""

    cause = "presliding_friction"
    title = "dry friction with elastic presliding"
    check = "Check seals, bearings' preload and the brake's lining: the contact springs before it slides."
    separating = Experiment("speeds", "small motions around many positions, and slow moves that reverse")
    family = "friction"
    looks_like = ("coulomb_friction", "stribeck_friction", "spring_hysteresis")
    parts = ("dry",)
    over, path = "position", True
    sizes = (Size(FRICTION, share("torque"), 0.15, 0.30, JOINT_SOURCE),)

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = rms([v.wave(place.pattern(v.structure)) for v in views])
        return [(float(np.log(max(size, 1e-300) * f)),) for f in (0.05, 0.15, 0.35, 0.8)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(1e-3 * size)), float(np.log(2.0 * size)))]

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [ForceLaw(Law.SLIDER, at.mass(), -1, (at.positive("stiffness"), abs(at.value("torque"))))]
