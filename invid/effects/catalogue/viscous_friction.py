"""Viscous friction to ground: coefficient·velocity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.motion import View
from invid.model.parameters import ChainStructure
from invid.model.place import Place, mass_places
from invid.numerics.arrays import Complex128


class ViscousFriction(ImpedanceEffect):
    """Resistance coefficient·θ̇."""

    cause = "viscous_friction"
    title = "viscous friction"
    check = "Check the grease (too much, too stiff, cold) and the seals."
    separate = "slow constant-velocity moves in both directions at several speeds"
    family = "friction"
    parameters: ClassVar[Mapping[str, str]] = {"coefficient": "damping"}
    coefficients = ("coefficient",)
    lower, upper = (0.0,), (np.inf,)
    main = "coefficient"

    def places(self, structure: ChainStructure) -> list[Place]:
        return mass_places(structure)

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        out: Complex128 = (1j * view.omega * x[0]).astype(np.complex128)
        return out

    def carries(self, view: View, x: Sequence[float]) -> tuple[float, float]:
        return 0.0, float(x[0])

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"coefficient": float(x[0])}
