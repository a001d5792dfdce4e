"""Dry friction: torque·sgn(velocity)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace, dry_parameters
from invid.effects.parameter import Parameter
from invid.effects.sizes import AT_LOAD, FRICTION, JOINT_SOURCE, Size, sag, share
from invid.effects.supposed.law import Bounds, InnerLaw, Shape, SpotMotion, extent
from invid.model.place import mass_places
from invid.numerics.arrays import Float64


class CoulombFriction(Effect):
    """Resistance torque·sgn(θ̇)."""

    cause = "coulomb_friction"
    title = "dry friction"
    check = "Check brake release and lubrication."
    separating = Experiment("speeds", "slow constant-velocity moves in both directions at several speeds")
    family = "friction"
    stands = (mass_places,)
    looks_like = ("stribeck_friction", "presliding_friction", "asymmetric_friction", "backlash")
    over = "velocity"
    sizes = (Size(FRICTION, share("torque"), 0.15, 0.30, JOINT_SOURCE), Size(AT_LOAD, sag))
    numbers = (Parameter("torque", "torque", low=0.0),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = p["torque"] * np.sign(x)
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [ForceLaw(Law.DRY, at.mass(), -1, dry_parameters(abs(at.value("torque"))))]


class InnerDry(InnerLaw):
    """Dry friction of a mass behind the motor; shape ln(width of its turn)."""

    effect: Effect = CoulombFriction()
    low: tuple[float, ...] = (0.0,)
    FIRST, LEAST, MOST = 0.02, 2e-3, 0.3

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn: Float64 = np.tanh(motion.velocity / np.exp(shape[0]))[:, None]
        return turn

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        size = extent([m.velocity for m in motions], 0.7)
        return [(float(np.log(self.FIRST * size)),)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        size = extent([m.velocity for m in motions], 0.7)
        return [(float(np.log(self.LEAST * size)), float(np.log(self.MOST * size)))]
