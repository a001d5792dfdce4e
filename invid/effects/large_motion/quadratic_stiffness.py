"""A spring to ground with a force of the square of its deflection; shown by large motion alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, GroundSpring, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.numerics.arrays import Float64


class QuadraticStiffness(Effect):
    """Resistance coefficient·q² of an axis that hangs on a spring."""

    cause = "quadratic_stiffness"
    title = "a spring force with the square of the deflection"
    check = "The spring is not linear: identify at the amplitude it is used at."
    separating = Experiment("amplitudes", "a second amplitude of the same excitation")
    family = "spring"
    stands = ()
    looks_like = ("cubic_stiffness", "gravity")
    home = "spring"
    over = "deflection"
    numbers = (Parameter("coefficient", "torque/position^2"),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["coefficient"] * x**2
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [GroundSpring(at.axis, 2, at.value("coefficient"))]


class QuadraticStiffnessLaw(SupposedLaw):
    """A spring to ground with a force of the square of its deflection."""

    effect, main = QuadraticStiffness(), "coefficient"

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        square: Float64 = motion.position[:, None] ** 2
        return square
