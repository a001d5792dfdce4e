"""Stribeck friction: static friction that falls to the Coulomb level as the velocity grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.catalogue.coulomb_friction import InnerDry
from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace, dry_parameters
from invid.effects.sizes import FRICTION, JOINT_SOURCE, Size, share
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, extent
from invid.errors import ModelError
from invid.model.place import mass_places
from invid.numerics.arrays import Float64


class StribeckFriction(Effect):
    """Resistance (coulomb + (static − coulomb)·exp(−(θ̇/velocity)²))·sgn(θ̇)."""

    cause = "stribeck_friction"
    title = "dry friction that sticks before it slides (Stribeck)"
    check = "Check the lubrication: the film builds too late."
    separating = Experiment("speeds", "slow constant-velocity moves in both directions at several speeds")
    family = "friction"
    stands = (mass_places,)
    looks_like = ("coulomb_friction", "presliding_friction", "asymmetric_friction")
    over = "velocity"
    sizes = (Size(FRICTION, share("static", "coulomb"), 0.15, 0.30, JOINT_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {
        "static": "torque",
        "coulomb": "torque",
        "velocity": "velocity",
    }
    main = "coulomb"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        near = np.exp(-((np.abs(x) / p["velocity"]) ** p.get("exponent", 2.0)))
        out: Float64 = (p["coulomb"] + (p["static"] - p["coulomb"]) * near) * np.sign(x)
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        velocity = abs(at.value("velocity"))
        if velocity == 0:
            raise ModelError(f"effect stribeck_friction on {at.term.axis}: velocity is 0; it must be > 0")
        excess = at.value("static") - at.value("coulomb")
        levels = dry_parameters(at.value("coulomb"), excess, velocity, at.optional("exponent", 2.0))
        return [ForceLaw(Law.DRY, at.mass(), -1, levels)]


class InnerStribeck(InnerDry):
    """Dry friction of a mass behind the motor that rises at slow speed; shapes ln(width), ln(velocity)."""

    effect, low = StribeckFriction(), (0.0, 0.0)
    contains = (InnerDry,)
    VELOCITIES = (0.1, 0.3, 0.9)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn = np.tanh(motion.velocity / np.exp(shape[0]))
        slow = np.exp(-((motion.velocity / np.exp(shape[1])) ** 2))
        return np.stack((turn, slow * turn), axis=1)

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        size = extent([m.velocity for m in motions], 0.7)
        (width,) = super().shapes(motions)[0]
        return [(width, float(np.log(v * size))) for v in self.VELOCITIES]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        size = extent([m.velocity for m in motions], 0.7)
        return [*super().bounds(motions), (float(np.log(0.01 * size)), float(np.log(3.0 * size)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        dry, rise = (float(c) for c in coefficients)
        return {"static": dry + rise, "coulomb": dry, "velocity": float(np.exp(shape[1]))}
