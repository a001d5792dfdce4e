"""Dry friction that grows with the load on the joint; shown by large motion alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, LoadFriction, ModelPlace


class LoadDependentFriction(Effect):
    """Resistance coefficient·|load|·sgn(θ̇), the load with its inertia or without."""

    cause = "load_dependent_friction"
    title = "friction that grows with the load on the joint"
    check = "Look at the bearings, the preload and the gear's efficiency under load."
    separating = Experiment(
        "positions", "the same motion with another payload: this friction changes with it"
    )
    family = "friction"
    # A load that hardly varies, as in small motion, makes it Coulomb friction.
    looks_like = ("coulomb_friction", "asymmetric_friction")
    parameters: ClassVar[Mapping[str, str]] = {"coefficient": "ratio", "inertia_counts": "count"}
    main = "coefficient"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [LoadFriction(at.axis, at.value("coefficient"), at.optional("inertia_counts", 0.0))]
