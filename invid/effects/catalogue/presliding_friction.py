"""Presliding: the contact gives elastically before it slides."""

from __future__ import annotations

from collections.abc import Sequence

from invid.effects.catalogue.coulomb_friction import CoulombFriction, InnerDry
from invid.effects.effect import Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace, dry_parameters
from invid.effects.laws.slider import SliderEffect, SliderLaw
from invid.effects.sizes import FRICTION, JOINT_SOURCE, Size, share
from invid.effects.supposed.law import AtMotor, InnerLaw, Shape
from invid.model.place import mass_places
from invid.numerics.arrays import Float64


class PreslidingFriction(SliderEffect):
    """Resistance stiffness·z with z the slider's displacement, |stiffness·z| ≤ torque."""

    cause = "presliding_friction"
    title = "dry friction with elastic presliding"
    check = "Check seals, bearings' preload and the brake's lining: the contact springs before it slides."
    separating = Experiment("speeds", "small motions around many positions, and slow moves that reverse")
    family = "friction"
    stands = (mass_places,)
    looks_like = ("coulomb_friction", "stribeck_friction", "spring_hysteresis")
    over, path = "position", True
    sizes = (Size(FRICTION, share("torque"), 0.15, 0.30, JOINT_SOURCE),)

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        if at.rigid:  # what it gives before it slides is below the travel of such a machine's moves
            return [ForceLaw(Law.DRY, at.mass(), -1, dry_parameters(abs(at.value("torque"))))]
        return [ForceLaw(Law.SLIDER, at.mass(), -1, (at.positive("stiffness"), abs(at.value("torque"))))]


class PreslidingAtMotor(AtMotor, SliderLaw):
    """Dry friction of a motor that yields elastically before it slides."""

    effect = PreslidingFriction()
    covers = frozenset({"dry", "rise"})


class HeldAtMotor(AtMotor, SliderLaw):
    """Dry friction that a motor keeps while it stands, and that turns within what its reading shows."""

    effect = CoulombFriction()

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"torque": float(coefficients[0])}


class InnerPresliding(InnerLaw, SliderLaw):
    """The same of a mass behind the motor."""

    effect = PreslidingFriction()
    contains = (InnerDry,)
