"""Friction that differs between the directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.sizes import FRICTION, JOINT_SOURCE, Size, asymmetric_share
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
