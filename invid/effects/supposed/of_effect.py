"""The law of a cause in a file of its own, and a law without a name, as the search supposes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import PlaceMotion
from invid.effects.laws.empirical_law import EmpiricalLaw
from invid.effects.motion_effect import MotionEffect
from invid.effects.supposed.law import SMOOTH, Bounds, Shape, SpotMotion, SupposedLaw
from invid.effects.units import unit_of
from invid.numerics.arrays import Float64

TURN = 0.02
"""Speed over its rms below which a law may soften the direction of motion."""


class EffectLaw(SupposedLaw):
    """The law of a ``MotionEffect``: its resistance as waves, its parameters that are not linear as
    shapes."""

    def __init__(self, effect: MotionEffect) -> None:
        self.motion_effect = effect
        self.effect = effect
        self.low = tuple(p.low for p in effect.linear)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        rest = TURN * float(np.sqrt((motion.velocity**2).mean()))
        moved = PlaceMotion(motion.position, motion.velocity, motion.time, rest)
        return self.motion_effect.resistance(moved, self._units(shape))

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(p.low, p.high) for p in self.motion_effect.linear]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        position, velocity = (
            max(float(np.sqrt(np.mean([(w**2).mean() for w in waves]))), 1e-300)
            for waves in ([m.position for m in motions], [m.velocity for m in motions])
        )
        shapes = self.motion_effect.nonlinear
        return [
            tuple(float(np.log(s)) if p.logarithmic else float(s) for s, p in zip(one, shapes, strict=True))
            for one in self.motion_effect.starts(position, velocity)
        ]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        """Those of the parameters; of a position or velocity at most the range of the motion."""
        seen = {
            unit_of("position", False): np.concatenate([m.position for m in motions]),
            unit_of("velocity", False): np.concatenate([m.velocity for m in motions]),
        }
        out = []
        for p in self.motion_effect.nonlinear:
            low, high = p.low, p.high
            wave = seen.get(unit_of(p.unit, False))
            if p.logarithmic:
                top = np.inf if wave is None else 10.0 * float(np.abs(wave).max())
                low, high = (float(np.log(max(v, 1e-300))) for v in (low, min(high, top)))
                low = max(low, high - 14.0)
            elif wave is not None:
                low, high = max(low, float(wave.min())), min(high, float(wave.max()))
            out.append((low, max(low, high)))
        return out

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        effect = self.motion_effect
        values = [*map(float, coefficients), *self._units(shape)]
        return {p.name: v for p, v in zip((*effect.linear, *effect.nonlinear), values, strict=True)}

    def _units(self, shape: Shape) -> list[float]:
        shapes = self.motion_effect.nonlinear
        return [float(np.exp(s)) if p.logarithmic else float(s) for s, p in zip(shape, shapes, strict=True)]


class SmoothLaw(SupposedLaw):
    """A law without a name as the search supposes it: the shapes of a spline, each with its size."""

    is_smooth = True

    def __init__(self, law: EmpiricalLaw) -> None:
        self.effect = self.law = law
        self.low = (-np.inf,) * law.splines.shape[1]

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return SMOOTH

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return self.law.resistance(PlaceMotion(motion.position, motion.velocity, motion.time), ())

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"torque": float(np.abs(self.law.splines @ coefficients).max())}
