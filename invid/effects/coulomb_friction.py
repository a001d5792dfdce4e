"""Dry friction: torque·sgn(velocity)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Float64
from invid.effects.base import ForceEffect, Place, View, mass_places
from invid.refine.structure import ChainStructure


def averaged(velocity: Float64, antiderivative: Float64, plain: Float64) -> Float64:
    """Mean of a discontinuous law over the two samples around each, triangle weighted.

    With the velocity linear between samples the mean over an interval is ΔΦ/Δv, Φ the antiderivative
    of the law: no aliasing of the jumps (antiderivative antialiasing).
    """
    dv = np.roll(velocity, -1) - velocity
    dphi = np.roll(antiderivative, -1) - antiderivative
    small = np.abs(dv) < 1e-9 * max(float(np.abs(velocity).max(initial=0.0)), 1e-300)
    between = np.where(small, 0.5 * (plain + np.roll(plain, -1)), dphi / np.where(small, 1.0, dv))
    out: Float64 = 0.5 * (between + np.roll(between, 1))
    return out


def softness(view: View, place: Place) -> float:
    """Velocity below which its sign is noise [rad/s or m/s]."""
    pattern = place.pattern(view.structure)
    v = view.velocity(pattern)
    noise = float(view.record.velocity_noise[place.axis])
    return max(1.5 * noise, 1e-3 * float(np.sqrt(np.mean(v**2))), 1e-300)


def sign_law(v: Float64, soft: float) -> Float64:
    """(n,) the sign of the velocity, averaged over samples."""
    phi = soft * (np.abs(v / soft) + np.log1p(np.exp(-2.0 * np.abs(v / soft))))
    return averaged(v, phi, np.tanh(v / soft))


class CoulombFriction(ForceEffect):
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

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        v = view.velocity(place.pattern(view.structure))
        return sign_law(v, softness(view, place))[:, None]

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"torque": float(x[0])}
