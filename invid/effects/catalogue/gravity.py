"""Gravity: a sinusoid of the angle, one cycle a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import CarriedWeight, Element, ForceLaw, Law, ModelPlace
from invid.effects.sizes import AT_LOAD, GRAVITY, RATED_SOURCE, Size, sag, share
from invid.effects.supposed.law import SinusoidLaw
from invid.model.place import end_places, motor_places
from invid.numerics.arrays import Float64


class Gravity(Effect):
    """Resistance torque·sin(q + angle), q the position of the final mass, or of the motor."""

    cause = "gravity"
    title = "gravity on the load"
    check = "Give the controller the load's weight and centre of gravity; check the balancer."
    separating = Experiment(
        "positions",
        "the same motion around positions far apart: gravity changes with position, an offset does not",
    )
    family = "position"
    # A motor may carry weight itself (a counterweight, a pulley) before its springs.
    stands = (end_places, motor_places)
    looks_like = ("torque_offset", "cogging")
    home = "end"
    over = "position"
    sizes = (Size(GRAVITY, share("torque"), 1.0, 1.0, RATED_SOURCE, linear=True), Size(AT_LOAD, sag))
    parameters: ClassVar[Mapping[str, str]] = {"torque": "torque", "angle": "angle"}
    rotary = True
    main = "torque"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["torque"] * np.sin(x + p["angle"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        torque, angle = at.value("torque"), at.value("angle")
        if at.rigid and at.term.other_axis is not None:
            return [CarriedWeight(torque * np.cos(angle), torque * np.sin(angle))]
        return [ForceLaw(Law.SINE, at.mass(at.last), -1, (torque, 1.0, angle))]


class GravityLaw(SinusoidLaw):
    """A torque of one cycle a revolution at a load or a motor.

    On a small motion it is a constant torque and a spring to ground: it takes the place of the first.
    """

    effect, phase = Gravity(), "angle"
    covers = frozenset({"offset"})
