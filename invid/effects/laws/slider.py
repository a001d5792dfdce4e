"""The elastoplastic element (a spring that slides at its limit), shared by two causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw, extent
from invid.numerics.arrays import Float64
from invid.numerics.compiled import compiled

MOST_OPEN = 0.01
"""Distance between start and end, over the range of the motion, up to which a record counts as periodic.
Empirical: after two settled periods a thousandth is left; a record from rest may end anywhere."""


def slide(x: Float64, most: float, *, periodic: bool) -> Float64:
    """(n,) displacement of a slider that slides at ``most``: the periodic state, or from rest.

    A record that still settles a little has the state of its last period at its start, not that of rest.
    """
    is_closed = abs(float(x[-1] - x[0])) < MOST_OPEN * float(np.ptp(x))
    return _slid(np.ascontiguousarray(x), most, 2 if periodic or is_closed else 1)


@compiled
def _slid(x: Float64, most: float, rounds: int) -> Float64:
    out, z, last = np.empty_like(x), 0.0, x[0]
    for _ in range(rounds):
        for k in range(x.size):
            z = min(max(z + x[k] - last, -most), most)
            out[k], last = z, x[k]
    return out


class SliderEffect(Effect):
    """A slider along a pattern: ``torque`` times its displacement over the ``most`` that it gives way at."""

    parameters: ClassVar[Mapping[str, str]] = {"stiffness": "stiffness", "torque": "torque"}
    main = "torque"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        most = p["torque"] / p["stiffness"]
        # A path walked twice; the second time is drawn.
        return p["stiffness"] * slide(x, most, periodic=True)


class SliderLaw(SupposedLaw):
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
