"""Dry friction that grows with the load on the joint; shown by large motion alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, LoadFriction, ModelPlace
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.numerics.arrays import Float64


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
    stands = ()
    looks_like = ("coulomb_friction", "asymmetric_friction")
    parameters: ClassVar[Mapping[str, str]] = {"coefficient": "ratio", "inertia_counts": "count"}
    main = "coefficient"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [LoadFriction(at.axis, at.value("coefficient"), at.optional("inertia_counts", 0.0))]


class LoadFrictionLaw(SupposedLaw):
    """A share of the load, its weight alone or (``whole``) with what accelerates; ``torque`` of the motion is
    the load.

    Hamon, Gautier, Garrec, "Dynamic identification of robots with a dry friction model depending on load and
    velocity", ICRA 2010.
    """

    effect, main, low = LoadDependentFriction(), "coefficient", (0.0,)

    def __init__(self, *, whole: bool) -> None:
        self.whole = whole

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        load = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return (np.abs(load) * np.sign(motion.velocity))[:, None]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"coefficient": float(coefficients[0]), "inertia_counts": float(self.whole)}
