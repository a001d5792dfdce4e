"""A spring that stiffens (or softens) with the cube of its deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.catalogue.backlash import largest_deflection, spring_index
from invid.effects.effect import Experiment, ForceEffect, PlaceMotion
from invid.effects.elements import Element, ForceLaw, GroundSpring, Law, ModelPlace
from invid.effects.motion import View
from invid.effects.parameter import Parameter
from invid.effects.sizes import STIFFENING_SOURCE, STIFFER, Size, stiffening
from invid.model.parameters import ChainStructure
from invid.model.place import Place, spring_places
from invid.numerics.arrays import Float64


class CubicStiffness(ForceEffect):
    """Spring torque coefficient·d³ beside the linear one."""

    cause = "cubic_stiffness"
    title = "a transmission that stiffens with its deflection"
    check = "Check gear, belt or coupling for preload and wear; identify at the amplitude the axis works at."
    separating = Experiment("amplitudes", "a second amplitude of the same excitation")
    family = "spring"
    looks_like = ("backlash", "spring_hysteresis")
    home = "spring"
    over = "deflection"
    sizes = (Size(STIFFER, stiffening, 1.0, 2.0, STIFFENING_SOURCE),)
    numbers = (Parameter("coefficient", "cubic"),)
    answered = True

    def places(self, structure: ChainStructure) -> list[Place]:
        return spring_places(structure)

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        deflection = view.wave(place.pattern(view.structure))[:, None]
        out: Float64 = deflection * deflection * deflection  # a power takes thirty times as long
        return out

    def beyond(self, views: Sequence[View], place: Place, x: Sequence[float]) -> bool:
        most = largest_deflection(views, place)
        # One that softens pulls back less and less; beyond here it would push.
        return bool(views[0].springs[spring_index(views[0].structure, place)] + x[0] * most**2 <= 0.0)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["coefficient"] * x**3
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        if at.rigid:
            return [GroundSpring(at.axis, 3, at.value("coefficient"))]
        a, b, _, _ = at.spring()
        return [ForceLaw(Law.CUBIC, a, b, (at.value("coefficient"),))]

    def regressors(self, motion: PlaceMotion, shape: Sequence[float]) -> Float64:
        out: Float64 = motion.position[:, None] ** 3
        return out
