"""Friction that differs between the directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.laws.sign import DryLaw, sign_law
from invid.model.parameters import ChainStructure
from invid.model.place import Place, mass_places
from invid.numerics.arrays import Float64


class AsymmetricFriction(DryLaw):
    """Coulomb and viscous friction of their own for each direction."""

    cause = "asymmetric_friction"
    title = "friction that differs between the directions"
    check = "Check wear, preload and seals that act in one direction, and a load that pulls."
    separate = "slow constant-velocity moves in both directions at several speeds"
    family = "friction"
    parameters: ClassVar[Mapping[str, str]] = {
        "coulomb_positive": "torque",
        "coulomb_negative": "torque",
        "viscous_positive": "damping",
        "viscous_negative": "damping",
    }
    coefficients = ("coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative")
    lower, upper = (0.0,) * 4, (np.inf,) * 4
    main = "coulomb_positive"
    smeared = True

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def of(self, v: Float64, soft: float, shape: Sequence[float], turn: float) -> Float64:
        sign = sign_law(v, soft, turn)
        return np.stack([0.5 * (1 + sign), -0.5 * (1 - sign), np.maximum(v, 0.0), np.minimum(v, 0.0)], axis=1)

    def held(self, x: Sequence[float]) -> tuple[float, float]:
        return -x[1], x[0]

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.coefficients, x, strict=True)}
