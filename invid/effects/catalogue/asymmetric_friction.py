"""Friction that differs between the directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.catalogue.coulomb_friction import InnerDry
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.effects.catalogue.viscous_friction import InnerViscous
from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.sizes import FRICTION, JOINT_SOURCE, Size, asymmetric_share
from invid.effects.supposed.law import AtMotor, Shape, SpotMotion, SupposedLaw
from invid.model.place import mass_places
from invid.numerics.arrays import Float64


class AsymmetricFriction(Effect):
    """Coulomb and viscous friction of their own for each direction."""

    cause = "asymmetric_friction"
    title = "friction that differs between the directions"
    check = "Check wear, preload and seals that act in one direction, and a load that pulls."
    separating = Experiment("speeds", "slow constant-velocity moves in both directions at several speeds")
    family = "friction"
    stands = (mass_places,)
    looks_like = ("coulomb_friction", "viscous_friction", "torque_offset")
    over = "velocity"
    sizes = (Size(FRICTION, asymmetric_share, 0.15, 0.30, JOINT_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {
        "coulomb_positive": "torque",
        "coulomb_negative": "torque",
        "viscous_positive": "damping",
        "viscous_negative": "damping",
    }
    main = "coulomb_positive"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        speed = p.get("low_speed_velocity", 0.0)
        near = np.exp(-((np.abs(x) / speed) ** p.get("exponent", 2.0))) if speed > 0 else np.zeros_like(x)
        up = p["coulomb_positive"] + p["viscous_positive"] * x + near * p.get("low_speed_positive", 0.0)
        down = -p["coulomb_negative"] + p["viscous_negative"] * x - near * p.get("low_speed_negative", 0.0)
        out: Float64 = np.where(x > 0, up, down) - 0.5 * (p["coulomb_positive"] - p["coulomb_negative"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        up, down, velocity = 0.0, 0.0, 1.0
        if "low_speed_velocity" in at.term.parameters:
            up, down = at.value("low_speed_positive"), at.value("low_speed_negative")
            velocity = at.positive("low_speed_velocity")
        exponent = at.optional("exponent", 2.0)
        levels = at.value("coulomb_positive"), at.value("coulomb_negative"), up, velocity, down, exponent
        sides = at.value("viscous_positive"), at.value("viscous_negative")
        return [
            ForceLaw(Law.DRY, at.mass(), -1, levels),
            ForceLaw(Law.ONE_SIDED_VISCOUS, at.mass(), -1, sides),
        ]


def _filled(coefficients: Float64) -> Float64:
    """(4,) with zeros for friction beside that is not known."""
    return np.append(coefficients, np.zeros(4 - coefficients.size))


def _by_direction(dry: float, viscous: float, even: float, offset: float) -> dict[str, float]:
    return {
        "coulomb_positive": float(dry + offset),
        "coulomb_negative": float(dry - offset),
        "viscous_positive": float(viscous + even),
        "viscous_negative": float(viscous - even),
    }


class AsymmetricAtMotor(AtMotor):
    """What friction by direction has beyond a motor's dry and viscous friction and a constant torque.

    f = (c₊ + c₋)/2·sgn v + (v₊ + v₋)/2·v + (v₊ − v₋)/2·|v| + (c₊ − c₋)/2
    """

    effect = AsymmetricFriction()
    beside = ("dry", "viscous", "offset")

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return np.abs(motion.velocity)[:, None]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return _by_direction(*_filled(coefficients)[[1, 2, 0, 3]])


class InnerAsymmetric(InnerDry):
    """The same of a mass behind the motor; its constant part cannot be told from one at the motor."""

    effect, low = AsymmetricFriction(), (0.0, 0.0, -np.inf)
    beside = ("offset",)
    contains = (InnerDry, InnerViscous)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn = np.tanh(motion.velocity / np.exp(shape[0]))
        return np.stack((turn, motion.velocity, np.abs(motion.velocity)), axis=1)

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return _by_direction(*_filled(coefficients))


class LowSpeed(SupposedLaw):
    """How dry friction bends at low speed: by its first coefficient both ways, by its second, where it has
    one, more forward and less backward; shapes ln(speed) and the exponent."""

    def __init__(self, *low: float) -> None:
        self.effect = StribeckFriction() if len(low) == 1 else AsymmetricFriction()
        self.low = low

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        slow = np.exp(-((np.abs(motion.velocity) / np.exp(shape[0])) ** shape[1]))
        return np.stack((slow * np.sign(motion.velocity), slow), axis=1)[:, : len(self.low)]
