"""Friction beyond that of every motor: at masses behind motors, by direction, and what yields before it
slides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.catalogue.coulomb_friction import CoulombFriction
from invid.effects.catalogue.presliding_friction import PreslidingFriction
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.effects.effect import Effect
from invid.effects.laws.slider import slide
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw, extent
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64


class InnerLaw(SupposedLaw):
    """Friction of a mass behind the motor."""

    def places(self, chains: ChainStructure) -> list[Place]:
        return [p for p in self.effect.places(chains) if p.number > 1]


class InnerViscous(InnerLaw):
    """Viscous friction of a mass behind the motor."""

    effect, main, low = ViscousFriction(), "coefficient", (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return motion.velocity[:, None]


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


def _filled(coefficients: Float64) -> Float64:
    """(4,) with zeros for friction beside that is not known."""
    return np.append(coefficients, np.zeros(4 - coefficients.size))


def _by_direction(dry: float, viscous: float, even: float, offset: float) -> dict[str, float]:
    return {
        "coulomb_positive": float(dry + offset),
        "coulomb_negative": float(dry - offset),
        "viscous_positive": float(viscous + even),
        "viscous_negative": float(viscous - even),
    }


class AsymmetricAtMotor(SupposedLaw):
    """What friction by direction has beyond a motor's dry and viscous friction and a constant torque.

    f = (c₊ + c₋)/2·sgn v + (v₊ + v₋)/2·v + (v₊ − v₋)/2·|v| + (c₊ − c₋)/2
    """

    effect = AsymmetricFriction()
    beside = ("dry", "viscous", "offset")

    def places(self, chains: ChainStructure) -> list[Place]:
        return [p for p in self.effect.places(chains) if p.number == 1]

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return np.abs(motion.velocity)[:, None]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return _by_direction(*_filled(coefficients)[[1, 2, 0, 3]])


class InnerAsymmetric(InnerDry):
    """The same of a mass behind the motor; its constant part cannot be told from one at the motor."""

    effect, low = AsymmetricFriction(), (0.0, 0.0, -np.inf)
    beside = ("offset",)
    contains = (InnerDry, InnerViscous)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn = np.tanh(motion.velocity / np.exp(shape[0]))
        return np.stack((turn, motion.velocity, np.abs(motion.velocity)), axis=1)

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return _by_direction(*_filled(coefficients))


class Slider(SupposedLaw):
    """A spring that slides at its limit; shape ln(deflection at which it slides).

    The coefficient is the torque at which it slides.
    """

    low = (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        most = float(np.exp(shape[0]))
        return slide(motion.position, most, periodic=False)[:, None] / most

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        size = extent([m.position - m.position.mean() for m in motions], 0.9)
        return [(float(np.log(size * share)),) for share in (0.03, 0.1, 0.3)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        size = extent([m.position - m.position.mean() for m in motions], 0.9)
        return [(float(np.log(1e-3 * size)), float(np.log(size)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        torque = float(coefficients[0])
        return {"stiffness": torque / float(np.exp(shape[0])), "torque": torque}


class PreslidingAtMotor(Slider):
    """Dry friction of a motor that yields elastically before it slides."""

    effect = PreslidingFriction()
    covers = frozenset({"dry", "rise"})

    def places(self, chains: ChainStructure) -> list[Place]:
        return [p for p in self.effect.places(chains) if p.number == 1]


class InnerPresliding(InnerLaw, Slider):
    """The same of a mass behind the motor."""

    effect = PreslidingFriction()
    contains = (InnerDry,)
