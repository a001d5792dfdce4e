"""A spring between the loads of two axes: they are coupled by more than inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.motion import View
from invid.model.parameters import ChainStructure
from invid.model.place import Place, pair_places
from invid.numerics.arrays import Complex128


class CouplingStiffness(ImpedanceEffect):
    """A spring between the final masses of two axes."""

    cause = "coupling_stiffness"
    title = "an elastic coupling between two axes"
    check = "Look for a cable, hose, belt or common base that ties the two axes together."
    separate = "a slow move of one axis while the other is held"
    family = "structure"
    parameters: ClassVar[Mapping[str, str]] = {"stiffness": "stiffness"}
    coefficients = ("stiffness",)
    lower, upper = (0.0,), (np.inf,)
    least_axes = 2
    main = "stiffness"

    def places(self, structure: ChainStructure) -> list[Place]:
        return pair_places(structure)

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        out: Complex128 = np.full(view.omega.size, x[0], dtype=complex)
        # Where the axes stand in the record's mean is no deflection: the spring is slack there.
        out[0] = 0.0
        return out

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"stiffness": float(x[0])}
