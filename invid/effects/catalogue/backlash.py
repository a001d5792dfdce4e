"""Free play in series with a spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import ARCMIN, PLAY, PLAY_SOURCE, Size, size
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw, extent
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


class BacklashLaw(SupposedLaw):
    """Free play: a spring gives no force, and its damper none, while its deflection lies within ±gap/2.

    Its coefficients are the spring's own stiffness and damping, its shape is ln(gap). Of a gap that is small
    beside the deflection records show the product with the stiffness alone, so that its bounds are about the
    spring's own.
    """

    effect, low = Backlash(), (0.0, -np.inf)
    OWN = (0.8, 1.25)
    SMALLEST, LARGEST, RATIO = 3e-4, 0.6, 1.6
    """Gaps to score over the range of the deflection."""

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        half = 0.5 * float(np.exp(shape[0]))
        inside = np.abs(motion.position) < half
        return np.stack((-np.clip(motion.position, -half, half), -motion.velocity * inside), axis=1)

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        own = motions[0].own
        if own is None:
            return super().limits(motions)
        return [(self.OWN[0] * own, self.OWN[1] * own), (-np.inf, np.inf)]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = 2.0 * extent([m.position for m in motions], 0.995)
        count = int(np.log(self.LARGEST / self.SMALLEST) / np.log(self.RATIO))
        return [(float(np.log(top * self.LARGEST / self.RATIO**k)),) for k in range(count + 1)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        top = 2.0 * extent([m.position for m in motions], 0.999)
        return [(float(np.log(1e-4 * top)), float(np.log(top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gap": float(np.exp(shape[0]) * coefficients[0] / stiffness)}
