"""A spring that stiffens (or softens) with the cube of its deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, GroundSpring, Law, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import STIFFENING_SOURCE, STIFFER, Size, stiffening
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.model.place import spring_places
from invid.numerics.arrays import Float64


class CubicStiffness(Effect):
    """Spring torque coefficient·d³ beside the linear one."""

    cause = "cubic_stiffness"
    title = "a transmission that stiffens with its deflection"
    check = "Check gear, belt or coupling for preload and wear; identify at the amplitude the axis works at."
    separating = Experiment("amplitudes", "a second amplitude of the same excitation")
    family = "spring"
    stands = (spring_places,)
    looks_like = ("backlash", "spring_hysteresis")
    home = "spring"
    over = "deflection"
    sizes = (Size(STIFFER, stiffening, 1.0, 2.0, STIFFENING_SOURCE),)
    numbers = (Parameter("coefficient", "cubic"),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["coefficient"] * x**3
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        if at.rigid:
            return [GroundSpring(at.axis, 3, at.value("coefficient"))]
        a, b, _, _ = at.spring()
        return [ForceLaw(Law.CUBIC, a, b, (at.value("coefficient"),))]


class CubicStiffnessLaw(SupposedLaw):
    """A spring that hardens (or softens) with the third power of its deflection."""

    effect, main = CubicStiffness(), "coefficient"
    is_smooth = True

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        cube: Float64 = (motion.position**3)[:, None]
        return cube
