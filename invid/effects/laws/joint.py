"""Friction of a joint: dry, viscous, with a rise at slow speed, and different in the two directions.

The law with which a search of whole records starts at every motor. It is no cause of the catalogue: its
significant parts are named by the catalogue's laws (``invid.diagnosis.rules.whole_search``).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erf, exp, log1p, pi, sqrt, tanh

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.laws.sign import SATURATION, mean_between
from invid.effects.motion import View, rms
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.numerics.compiled import compiled
from invid.signals.standstill import sign_threshold

STRIBECK_START, STRIBECK_BOUNDS = 0.2, (0.01, 1.5)
"""Stribeck velocity, and width of a reversal, over the rms velocity: where they start, and their bounds."""
WIDTH_START, WIDTH_BOUNDS = 0.03, (1e-4, 0.3)
LEAST_SLOW = 3.0
"""Least Stribeck velocity over the width of a reversal: a rise within it is another width."""


class JointFriction(ForceEffect):
    """Resistance (dry + uneven_dry·s)·s + (viscous + uneven_viscous·s)·v + (slow + uneven_slow·s)·s·b, where
    s = tanh(v/width) and b = exp(−(v/velocity)²)."""

    cause = "joint_friction"
    family = "friction"
    parts = ("dry", "viscous")
    over = "velocity"
    coefficients = ("dry", "viscous", "slow", "uneven_dry", "uneven_viscous", "uneven_slow")
    lower, upper = (0.0, 0.0, 0.0, -np.inf, -np.inf, -np.inf), (np.inf,) * 6
    shapes, logarithmic = ("velocity", "width"), (True, True)
    smeared = True
    of_motor_motion = True

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = _rms_speed(views, place)
        return [(float(np.log(STRIBECK_START * size)), float(np.log(WIDTH_START * size)))]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = _rms_speed(views, place)
        return [
            (float(np.log(a * size)), float(np.log(b * size))) for a, b in (STRIBECK_BOUNDS, WIDTH_BOUNDS)
        ]

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        v = view.velocity(place.pattern(view.structure))
        slow, width = float(np.exp(shape[0])), float(np.exp(shape[1]))
        soft = max(sign_threshold(v, float(view.record.velocity_noise[place.axis])), width)
        out: Float64 = _mean_parts(np.ascontiguousarray(v), soft, max(slow, LEAST_SLOW * soft))
        return out


@compiled
def _mean_parts(v: np.ndarray, soft: float, slow: float) -> np.ndarray:
    """(n, 6) means of the parts over the samples, from their antiderivatives.

    Those of the parts at slow speed take b as one while s changes over: the width is the smaller by far.
    """
    count = v.size
    phi, plain, out = np.empty((6, count)), np.empty((6, count)), np.empty((count, 6))
    for k in range(count):
        u, w = abs(v[k]) / soft, v[k] / slow
        near = u < SATURATION
        size = tanh(u) if near else 1.0
        sign = size if v[k] > 0 else -size
        bend = exp(-w * w)
        reached = 0.5 * sqrt(pi) * slow * erf(w)
        overshoot = soft * (log1p(exp(-2.0 * u)) if near else 0.0)
        phi[0, k], plain[0, k] = abs(v[k]) + overshoot, sign
        phi[1, k], plain[1, k] = 0.5 * v[k] * v[k], v[k]
        phi[2, k], plain[2, k] = abs(reached) + overshoot, sign * bend
        phi[3, k], plain[3, k] = v[k] - soft * sign, size * size
        phi[4, k], plain[4, k] = 0.5 * v[k] * abs(v[k]), abs(v[k])
        phi[5, k], plain[5, k] = reached - soft * sign, size * size * bend
    for part in range(6):
        out[:, part] = mean_between(v, phi[part], plain[part])
    return out


def _rms_speed(views: Sequence[View], place: Place) -> float:
    return max(rms([v.velocity(place.pattern(v.structure)) for v in views]), 1e-300)
