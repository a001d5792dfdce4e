"""The law of a cause in a file of its own, as the search supposes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import PlaceMotion
from invid.effects.motion_effect import MotionEffect
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw
from invid.effects.units import unit_of
from invid.model.place import Place
from invid.numerics.arrays import Float64

PLACE = Place("mass", 0, 1)
"""Stands for every place: parameters of such an effect do not depend on it."""
TURN = 0.02
"""Speed over its rms below which a law may soften the direction of motion."""


class EffectLaw(SupposedLaw):
    """The law of a ``MotionEffect``: its resistance as waves, its parameters that are not linear as
    shapes."""

    def __init__(self, effect: MotionEffect) -> None:
        self.motion_effect = effect
        self.effect = effect
        self.low = effect.lower

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        rest = TURN * float(np.sqrt((motion.velocity**2).mean()))
        moved = PlaceMotion(motion.position, motion.velocity, motion.time, rest)
        return self.motion_effect.resistance(moved, self._units(shape))

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return list(zip(self.effect.lower, self.effect.upper, strict=True))

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        position, velocity = (
            max(float(np.sqrt(np.mean([(w**2).mean() for w in waves]))), 1e-300)
            for waves in ([m.position for m in motions], [m.velocity for m in motions])
        )
        logs = self.effect.logarithmic
        return [
            tuple(float(np.log(s)) if log else float(s) for s, log in zip(one, logs, strict=True))
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
        return self.effect.values([*coefficients, *shape], PLACE)

    def _units(self, shape: Shape) -> list[float]:
        logs = self.effect.logarithmic
        return [float(np.exp(s)) if log else float(s) for s, log in zip(shape, logs, strict=True)]
