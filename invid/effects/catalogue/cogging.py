"""Cogging: a torque that is a sinusoid of the motor's position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.sizes import COGGING_SOURCE, RIPPLE, Size, share
from invid.effects.supposed.law import Bounds, Shape, SinusoidLaw, SpotMotion, travel
from invid.model.place import motor_places
from invid.numerics.arrays import Float64


class Cogging(Effect):
    """Resistance torque·sin(cycles_per_rev·θ + phase) at the motor."""

    cause = "cogging"
    title = "a torque ripple over the motor's position (cogging)"
    check = "Check the motor's commutation offset; compensate the ripple in the drive where it can."
    separating = Experiment(
        "positions", "a slow move over a whole revolution: cogging repeats with its number of cycles"
    )
    family = "position"
    stands = (motor_places,)
    looks_like = ("gravity", "transmission_error")
    over = "position"
    sizes = (Size(RIPPLE, share("torque"), 0.02, 0.04, COGGING_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {
        "torque": "torque",
        "cycles_per_rev": "count",
        "phase": "angle",
    }
    main = "torque"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["torque"] * np.sin(p["cycles_per_rev"] * x + p["phase"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        wave = at.value("torque"), at.value("cycles_per_rev"), at.value("phase")
        return [ForceLaw(Law.SINE, at.mass(), -1, wave)]


class CoggingLaw(SinusoidLaw):
    """A torque that is a sinusoid of the motor's position; shape ln(cycles)."""

    effect = Cogging()
    several = True
    shape_step = 1e-3
    LEAST, MOST, PER_SPAN = 0.5, 400.0, 0.35

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        # Few cycles on a small motion are a spring to ground and a constant torque.
        span = travel(motions)
        step = max(self.PER_SPAN / span, 0.25)
        first = max(self.LEAST / span, 1.5)
        return [(float(np.log(n)),) for n in np.arange(first, max(self.MOST / 4, 12 * first), step)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(float(np.log(max(self.LEAST / travel(motions), 1.5))), float(np.log(2000.0)))]
