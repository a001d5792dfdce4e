"""Viscous friction to ground: coefficient·velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import AddedDamper, Element, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import AT_SPEED, JOINT_SOURCE, Size, viscous_share
from invid.effects.supposed.law import InnerLaw, Shape, SpotMotion
from invid.model.place import mass_places
from invid.numerics.arrays import Float64


class ViscousFriction(Effect):
    """Resistance coefficient·θ̇."""

    cause = "viscous_friction"
    title = "viscous friction"
    check = "Check the grease (too much, too stiff, cold) and the seals."
    separating = Experiment("speeds", "slow constant-velocity moves in both directions at several speeds")
    family = "friction"
    stands = (mass_places,)
    looks_like = ("coulomb_friction", "stribeck_friction", "asymmetric_friction")
    over = "velocity"
    sizes = (Size(AT_SPEED, viscous_share, 0.15, 0.30, JOINT_SOURCE),)
    numbers = (Parameter("coefficient", "damping", low=0.0),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["coefficient"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [AddedDamper(at.mass(), -1, at.value("coefficient"))]


class InnerViscous(InnerLaw):
    """Viscous friction of a mass behind the motor."""

    effect, main, low = ViscousFriction(), "coefficient", (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return motion.velocity[:, None]
