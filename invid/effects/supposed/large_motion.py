"""Laws that large motion of a rigid machine alone shows: low speed, load, a spring to ground."""

from __future__ import annotations

import numpy as np

from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.effects.large_motion.load_dependent_friction import LoadDependentFriction
from invid.effects.large_motion.quadratic_stiffness import QuadraticStiffness as QuadraticEffect
from invid.effects.laws.dry_friction import stribeck_decay
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.numerics.arrays import Float64


class QuadraticStiffness(SupposedLaw):
    """A spring to ground with a force of the square of its deflection."""

    effect, main = QuadraticEffect(), "coefficient"

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        square: Float64 = motion.position[:, None] ** 2
        return square


class LowSpeed(SupposedLaw):
    """How dry friction bends at low speed: by its first coefficient both ways, by its second, where it has
    one, more forward and less backward; shapes ln(speed) and the exponent."""

    def __init__(self, *low: float) -> None:
        self.effect = StribeckFriction() if len(low) == 1 else AsymmetricFriction()
        self.low = low

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        slow = stribeck_decay(motion.velocity, (float(np.exp(shape[0])), shape[1]))
        return np.stack((slow * np.sign(motion.velocity), slow), axis=1)[:, : len(self.low)]


class LoadFriction(SupposedLaw):
    """A share of the load, its weight alone or (``whole``) with what accelerates; ``torque`` of the motion is
    the load.

    Hamon, Gautier, Garrec, "Dynamic identification of robots with a dry friction model depending on load and
    velocity", ICRA 2010.
    """

    effect, main, low = LoadDependentFriction(), "coefficient", (0.0,)

    def __init__(self, *, whole: bool) -> None:
        self.whole = whole

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        load = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return (np.abs(load) * np.sign(motion.velocity))[:, None]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"coefficient": float(coefficients[0]), "inertia_counts": float(self.whole)}
