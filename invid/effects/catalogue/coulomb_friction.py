"""Dry friction: torque·sgn(velocity)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.laws.sign import DryLaw, sign_law
from invid.model.parameters import ChainStructure
from invid.model.place import Place, mass_places
from invid.numerics.arrays import Float64


class CoulombFriction(DryLaw):
    """Resistance torque·sgn(θ̇)."""

    cause = "coulomb_friction"
    title = "dry friction"
    check = "Check brake release and lubrication."
    separate = "slow constant-velocity moves in both directions at several speeds"
    family = "friction"
    parameters: ClassVar[Mapping[str, str]] = {"torque": "torque"}
    coefficients = ("torque",)
    lower, upper = (0.0,), (np.inf,)
    main = "torque"
    smeared = True

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def of(self, v: Float64, soft: float, shape: Sequence[float], turn: float) -> Float64:
        return sign_law(v, soft, turn)[:, None]

    def held(self, x: Sequence[float]) -> tuple[float, float]:
        return -x[0], x[0]

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(x[0])}
