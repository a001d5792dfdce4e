"""What is left: missing torque of each axis on records kept out, and the unknown force at every place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.unknown_forces.descent import fit
from invid.likelihood.unknown_forces.forces import Spot
from invid.likelihood.unknown_forces.supposition import Supposed
from invid.likelihood.unknown_forces.value import Value, missing_torque
from invid.numerics.arrays import Float64

SURE = 40.0
"""Rise of −2 ln L without a strength from which something acts at its place: at 1 % false alarms over
thirty places chance alone gives 13; the rest is friction's own shape (empirical: nulls of another hand)."""


@dataclass(frozen=True, eq=False)
class AxisMissing:
    """Rms of missing torque (M,) and what the sensors alone would leave (M,) [N·m]."""

    missing: Float64
    floor: Float64


def axis_missing(found: Supposed) -> AxisMissing:
    """On the records kept out, else on those fitted: rms over lines on which torque stands above the
    sensors."""
    value: Value = found.kept_value or found.fit.value
    motors = found.hypothesis.structure.motors
    power, floor, count = np.zeros(motors), np.zeros(motors), 0
    for k, work in enumerate(value.work):
        stack = work.stack
        stiffness = work.condensed.stiffness
        sensors = (np.abs(stiffness) ** 2 * stack.position_noise).sum(axis=2) + stack.torque_noise
        torque = (np.abs(stack.parts.sum(axis=0)) ** 2).mean(axis=(0, 1))
        use = (sensors < torque) * stack.weight[:, None]
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


@dataclass(frozen=True, eq=False)
class PlaceForce:
    """Unknown force at a place [N·m rms], and the rise of −2 ln L without it."""

    spot: Spot
    rms: float
    rise: float

    @property
    def is_sure(self) -> bool:
        """Whether something acts there."""
        return self.rise > SURE


def place_forces(found: Supposed, most: int = 4) -> list[PlaceForce]:
    """The strongest unknown forces, each with what its absence costs."""
    out = []
    problem = found.fit.problem
    for rms, spot in found.strength[:most]:
        number = problem.spots.number[spot]
        strength = found.numbers.strength.copy()
        strength[number] = problem.least
        closed = replace(problem, shut=np.array([*problem.shut, number]))
        without = fit(closed, replace(found.numbers, strength=strength), 8)
        out.append(PlaceForce(spot, rms, without.total - found.total))
    return out
