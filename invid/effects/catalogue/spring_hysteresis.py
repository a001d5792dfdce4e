"""Friction inside the transmission: a slider beside the spring."""

from __future__ import annotations

from collections.abc import Sequence

from invid.effects.effect import Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.laws.slider import SliderEffect, SliderLaw
from invid.effects.sizes import ARCMIN, HYSTERESIS_SOURCE, LOST, SPRING_FRICTION, Size, lost_motion, share
from invid.model.place import spring_places


class SpringHysteresis(SliderEffect):
    """Torque stiffness·z beside the spring, |stiffness·z| ≤ torque."""

    cause = "spring_hysteresis"
    title = "friction inside the transmission (hysteresis of the spring)"
    check = "Check gear or coupling for preload, grease and worn rubber; harmonic drives show it by nature."
    separating = Experiment(
        "amplitudes", "a second amplitude with the motor held: the loop's width does not grow with amplitude"
    )
    family = "spring"
    stands = (spring_places,)
    looks_like = ("backlash", "cubic_stiffness", "presliding_friction")
    home = "spring"
    over, path = "deflection", True
    sizes = (
        Size(LOST, lost_motion, 2 * ARCMIN, 4 * ARCMIN, HYSTERESIS_SOURCE),
        Size(SPRING_FRICTION, share("torque")),
    )

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, _, _ = at.spring()
        return [ForceLaw(Law.PAIR_SLIDER, a, b, (at.positive("stiffness"), abs(at.value("torque"))))]


class SpringHysteresisLaw(SliderLaw):
    """A slider beside a spring."""

    effect = SpringHysteresis()
