"""Laws of motors and loads: sinusoids of position, torque that does not act as recorded, readings that
swing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.catalogue.cogging import Cogging as CoggingEffect
from invid.effects.catalogue.encoder_eccentricity import EncoderEccentricity as EccentricityEffect
from invid.effects.catalogue.gravity import Gravity as GravityEffect
from invid.effects.catalogue.torque_gain import TorqueGain as GainEffect
from invid.effects.catalogue.torque_saturation import TorqueSaturation as SaturationEffect
from invid.effects.supposed.law import (
    Bounds,
    Shape,
    SpotMotion,
    SupposedLaw,
    amplitude_and_phase,
    ripple_stride,
    sinusoid,
    travel,
)
from invid.numerics.arrays import Float64


class Cogging(SupposedLaw):
    """A torque that is a sinusoid of the motor's position; shape ln(cycles)."""

    effect, low = CoggingEffect(), (-np.inf, -np.inf)
    several = True
    shape_step = 1e-3
    LEAST, MOST, PER_SPAN = 0.5, 400.0, 0.35

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return ripple_stride(motion, float(np.exp(shape[0])))

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return sinusoid(motion.position, float(np.exp(shape[0])))

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        # Few cycles on a small motion are a spring to ground and a constant torque.
        span = travel(motions)
        step = max(self.PER_SPAN / span, 0.25)
        first = max(self.LEAST / span, 1.5)
        return [(float(np.log(n)),) for n in np.arange(first, max(self.MOST / 4, 12 * first), step)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(float(np.log(max(self.LEAST / travel(motions), 1.5))), float(np.log(2000.0)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        torque, phase = amplitude_and_phase(coefficients)
        return {"torque": torque, "cycles_per_rev": float(np.exp(shape[0])), "phase": phase}


class Gravity(SupposedLaw):
    """A torque of one cycle a revolution at a load or a motor.

    On a small motion it is a constant torque and a spring to ground: it takes the place of the first.
    """

    effect, low = GravityEffect(), (-np.inf, -np.inf)
    covers = frozenset({"offset"})

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return ripple_stride(motion, 1.0)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return sinusoid(motion.position, 1.0)

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        torque, angle = amplitude_and_phase(coefficients)
        return {"torque": torque, "angle": angle}


class EncoderEccentricity(SupposedLaw):
    """An encoder that reads θ + amplitude·sin(θ + phase); its motor stands at the reading less that."""

    effect, low = EccentricityEffect(), (-np.inf, -np.inf)
    reads = True

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return ripple_stride(motion, 1.0)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return -sinusoid(motion.position, 1.0)

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(-0.5, 0.5), (-0.5, 0.5)]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        amplitude, phase = amplitude_and_phase(coefficients)
        return {"amplitude": amplitude, "phase": phase}


class TorqueSaturation(SupposedLaw):
    """Torque beyond a limit does not act; shape ln(limit). Its coefficient is one."""

    effect, low = SaturationEffect(), (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        limit = float(np.exp(shape[0]))
        torque = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return (torque - np.clip(torque, -limit, limit))[:, None]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(top * share)),) for share in (0.5, 0.65, 0.8, 0.9)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(0.2 * top)), float(np.log(0.98 * top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"limit": float(np.exp(shape[0]))}


class TorqueGain(SupposedLaw):
    """More or less torque acts than is recorded, by a share of it."""

    effect = GainEffect()
    scales = True

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return np.zeros((motion.position.size, 1))

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(-0.5, 1.0)]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gain": 1.0 + float(coefficients[0])}
