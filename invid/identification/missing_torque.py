"""Torque that each axis misses on records kept out, beside what its sensors alone would leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.value import Value, missing_torque
from invid.numerics.arrays import Float64

LOUD = 10.0
"""Sensors' noise of a line over its median from which the line says nothing (empirical)."""


@dataclass(frozen=True, eq=False)
class AxisMissing:
    """Rms of missing torque, of what the sensors alone would leave, and of the torque, (M,) each [N·m]."""

    missing: Float64
    floor: Float64
    torque: Float64


def axis_missing(found: FittedHypothesis) -> AxisMissing:
    """On the records kept out, else on those fitted: rms over the informative lines, on which torque stands
    above the sensors, and not those where the plant multiplies the encoders' noise; torque over all."""
    value: Value = found.kept_value or found.fit.value
    sums, count = np.zeros((3, found.hypothesis.structure.motors)), 0
    for k, work in enumerate(value.work):
        stack = work.stack
        sensors = (np.abs(work.condensed.stiffness) ** 2 * work.position_noise).sum(
            axis=2
        ) + work.torque_noise
        torque, weight = np.abs(stack.parts.sum(axis=0)) ** 2, stack.weight[:, None]
        use = (sensors < torque.mean(axis=(0, 1))) & (sensors <= LOUD * np.median(sensors, axis=0))
        sums[0] += ((np.abs(missing_torque(value, k)) ** 2) * (use * weight)).sum(axis=(0, 1))
        sums[1] += stack.count * (sensors * use * weight).sum(axis=0)
        sums[2] += (torque * weight).sum(axis=(0, 1))
        count += stack.count
    return AxisMissing(*np.sqrt(sums / (2.0 * count)))


def missed_share(found: FittedHypothesis) -> float:
    """Rms share of the torque that is missing beyond the sensors' noise, of the worst axis."""
    at = axis_missing(found)
    left = np.maximum(at.missing**2 - at.floor**2, 0.0) / np.maximum(at.torque**2, 1e-300)
    return float(np.sqrt(left.max()))
