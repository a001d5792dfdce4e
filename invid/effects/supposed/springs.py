"""Laws of springs: deflection, its history, and the gear's angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.catalogue.backlash import Backlash as BacklashEffect
from invid.effects.catalogue.cubic_stiffness import CubicStiffness as CubicEffect
from invid.effects.catalogue.spring_hysteresis import SpringHysteresis as HysteresisEffect
from invid.effects.catalogue.transmission_error import TransmissionError as TransmissionEffect
from invid.effects.supposed.friction import Slider
from invid.effects.supposed.law import (
    Bounds,
    Shape,
    SpotMotion,
    SupposedLaw,
    amplitude_and_phase,
    extent,
    ripple_stride,
    sinusoid,
)
from invid.numerics.arrays import Float64


class Backlash(SupposedLaw):
    """Free play: a spring gives no force, and its damper none, while its deflection lies within ±gap/2.

    Its coefficients are the spring's own stiffness and damping, its shape is ln(gap). Of a gap that is small
    beside the deflection records show the product with the stiffness alone, so that its bounds are about the
    spring's own.
    """

    effect, low = BacklashEffect(), (0.0, -np.inf)
    OWN = (0.8, 1.25)
    SMALLEST, LARGEST, RATIO = 3e-4, 0.6, 1.6
    """Gaps to score over the range of the deflection."""

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        half = 0.5 * float(np.exp(shape[0]))
        inside = np.abs(motion.position) < half
        return np.stack((-np.clip(motion.position, -half, half), -motion.velocity * inside), axis=1)

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        own = motions[0].own
        if own is None:
            return super().limits(motions)
        return [(self.OWN[0] * own, self.OWN[1] * own), (-np.inf, np.inf)]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = 2.0 * extent([m.position for m in motions], 0.995)
        count = int(np.log(self.LARGEST / self.SMALLEST) / np.log(self.RATIO))
        return [(float(np.log(top * self.LARGEST / self.RATIO**k)),) for k in range(count + 1)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        top = 2.0 * extent([m.position for m in motions], 0.999)
        return [(float(np.log(1e-4 * top)), float(np.log(top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gap": float(np.exp(shape[0]) * coefficients[0] / stiffness)}


class CubicStiffness(SupposedLaw):
    """A spring that hardens (or softens) with the third power of its deflection."""

    effect, main = CubicEffect(), "coefficient"

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        cube: Float64 = (motion.position**3)[:, None]
        return cube


class SpringHysteresis(Slider):
    """A slider beside a spring."""

    effect = HysteresisEffect()


class TransmissionError(SupposedLaw):
    """A sinusoid of the gear's angle in the deflection of its spring; shape ln(cycles)."""

    effect, low = TransmissionEffect(), (-np.inf, -np.inf)
    shape_step = 1e-3
    LEAST, MOST = 2.0, 120.0

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return ripple_stride(motion, float(np.exp(shape[0])))

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return sinusoid(motion.angle, float(np.exp(shape[0])))

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        span = extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(n)),) for n in np.arange(self.LEAST / span, self.MOST, max(0.35 / span, 0.25))]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        span = extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(self.LEAST / span)), float(np.log(self.MOST)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        torque, phase = amplitude_and_phase(coefficients)
        cycles = float(np.exp(shape[0]))
        return {"amplitude": torque / stiffness, "cycles_per_rev": cycles, "phase": phase}
