"""Torque that each axis misses on records kept out, beside what its sensors alone would leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.supposition import Supposed
from invid.likelihood.unknown_forces.value import Value, missing_torque
from invid.numerics.arrays import Float64

LOUD = 10.0
"""Sensors' noise of a line over its median from which the line says nothing (empirical)."""


@dataclass(frozen=True, eq=False)
class AxisMissing:
    """Rms of missing torque (M,) and what the sensors alone would leave (M,) [N·m]."""

    missing: Float64
    floor: Float64


def axis_missing(found: Supposed) -> AxisMissing:
    """On the records kept out, else on those fitted: rms over the informative lines, on which torque stands
    above the sensors, and not those where the plant multiplies the encoders' noise."""
    value: Value = found.kept_value or found.fit.value
    motors = found.hypothesis.structure.motors
    power, floor, count = np.zeros(motors), np.zeros(motors), 0
    for k, work in enumerate(value.work):
        stack = work.stack
        stiffness = work.condensed.stiffness
        sensors = (np.abs(stiffness) ** 2 * work.position_noise).sum(axis=2) + work.torque_noise
        torque = (np.abs(stack.parts.sum(axis=0)) ** 2).mean(axis=(0, 1))
        use = (sensors < torque) & (sensors <= LOUD * np.median(sensors, axis=0))
        use = use * stack.weight[:, None]
        power += ((np.abs(missing_torque(value, k)) ** 2) * use).sum(axis=(0, 1)) / 2.0
        floor += stack.count * (sensors * use).sum(axis=0) / 2.0
        count += stack.count
    return AxisMissing(np.sqrt(power / count), np.sqrt(floor / count))


def missed_share(found: Supposed) -> float:
    """Rms share of the torque that is missing beyond the sensors' noise, of the worst axis."""
    value = found.kept_value or found.fit.value
    at = axis_missing(found)
    power = [
        (np.abs(w.stack.parts.sum(axis=0)) ** 2 * w.stack.weight[:, None]).sum(axis=(0, 1)) / 2.0
        for w in value.work
    ]
    torque = np.sum(power, axis=0) / sum(w.stack.count for w in value.work)
    left = np.maximum(at.missing**2 - at.floor**2, 0.0) / np.maximum(torque, 1e-300)
    return float(np.sqrt(left.max()))
