"""Free play in series with a spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import ARCMIN, PLAY, PLAY_SOURCE, Size, size
from invid.model.place import spring_places
from invid.numerics.arrays import Float64


class Backlash(Effect):
    """Spring and damper act on the part of the deflection beyond ±gap/2."""

    cause = "backlash"
    title = "free play in the transmission (backlash)"
    check = "Check the gear's wear, keys and couplings; measure the free play with the motor locked."
    separating = Experiment(
        "amplitudes", "a second amplitude: free play matters most when the motion is small"
    )
    family = "spring"
    stands = (spring_places,)
    looks_like = ("cubic_stiffness", "spring_hysteresis", "coulomb_friction")
    home = "spring"
    over = "deflection"
    sizes = (Size(PLAY, size("gap"), 1 * ARCMIN, 3 * ARCMIN, PLAY_SOURCE),)
    numbers = (Parameter("gap", "position", linear=False),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = stiffness * (np.sign(x) * np.maximum(np.abs(x) - 0.5 * p["gap"], 0.0) - x)
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, stiffness, damping = at.spring()
        return [ForceLaw(Law.BACKLASH, a, b, (0.5 * abs(at.value("gap")), stiffness, damping))]
