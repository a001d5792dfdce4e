"""Dry friction of a motor whose drive's torque is recorded: what it is while the motor is slow.

A law of velocity has no value at standstill, and the instant of a reversal is worth a share of a sample.
Both follow from the motor's own equation, J·dω/dt = drive + spring − friction: from the last sample at which
the velocity is told, the motor is followed until it is told again. It slows down to zero, and there either
turns round or stands; where it stands, friction is whatever acts, up to its limits.
"""

from __future__ import annotations

import numpy as np

from invid.effects.motion import View
from invid.numerics.arrays import Float64
from invid.numerics.compiled import compiled


@compiled
def follow_motor(  # noqa: PLR0913 - a compiled kernel
    velocity: np.ndarray,
    moving: np.ndarray,
    drive: np.ndarray,
    spring: np.ndarray,
    forward: np.ndarray,
    backward: np.ndarray,
    slow: float,
    lightness: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) mean friction over the interval after each sample, and (n,) the share of it in which it holds.

    Parameters
    ----------
    velocity
        (n,) of the motor at the samples [rad/s]; the record closes: after the last comes the first.
    moving
        (n,) friction by its law at ``velocity`` [N·m].
    drive
        (n, k) mean torque of the drive over the k parts of each interval [N·m].
    spring
        (n,) torque of the spring at the samples [N·m].
    forward, backward
        (m,) friction at speeds from none to ``slow``, in either direction.
    slow
        Speed below which the velocity does not tell the friction [rad/s].
    lightness
        One over the motor's inertia [1/(kg·m²)].
    step
        Length of an interval [s].
    """
    count, parts = drive.shape
    tiny = step / parts
    low, high = backward[0], forward[0]
    finer = (forward.size - 1) / slow
    friction, holds = np.empty(count), np.zeros(count)
    speed, follows = 0.0, False
    for k in range(count):
        after = k + 1 if k + 1 < count else 0
        if not (
            abs(velocity[k]) < slow or abs(velocity[after]) < slow or velocity[k] * velocity[after] <= 0.0
        ):
            friction[k] = 0.5 * (moving[k] + moving[after])
            follows = False
            continue
        if not follows or abs(velocity[k]) >= slow or abs(speed - velocity[k]) > slow:
            speed = velocity[k]
        follows = True
        total = 0.0
        for p in range(parts):
            share = (p + 0.5) / parts
            acting = drive[k, p] + (1.0 - share) * spring[k] + share * spring[after]
            left = tiny
            for _ in range(3):  # until it stops, from there on, and once more for rounding
                if speed == 0.0:
                    if low <= acting <= high:
                        total += acting * left
                        holds[k] += left / step
                        left = 0.0
                        break
                    resists = high if acting > high else low
                else:
                    at = min(abs(speed) * finer, forward.size - 1.001) if abs(speed) < np.inf else 0.0
                    j = int(at)
                    table = forward if speed > 0.0 else backward
                    resists = table[j] + (at - j) * (table[j + 1] - table[j])
                rate = lightness * (acting - resists)
                ends = speed + rate * left
                if speed != 0.0 and speed * ends < 0.0:
                    until = -speed / rate
                    total += resists * until
                    left -= until
                    speed = 0.0
                    continue
                total += resists * left
                speed = ends
                left = 0.0
                break
        friction[k] = total / step
    return friction, holds


def centred(mean: Float64, view: View) -> Float64:
    """(n,) means around each sample of means over the intervals after them."""
    before = np.roll(mean, 1)
    if view.record.transient:
        before[0] = mean[0]
        mean = mean.copy()
        mean[-1] = mean[-2]
    return 0.5 * (mean + before)


def torque_of_chain(view: View, axis: int) -> Float64:
    """(n,) torque on a motor by its springs, or by the inertia couplings of its chain's only mass."""
    structure = view.structure
    at = structure.motor_dofs[axis]
    out = -float(view.grounds[axis]) * view.wave(((at, 1.0),))
    if structure.sizes[axis] == 1:
        for j in np.flatnonzero(view.couplings[axis]):
            speed = view.velocity(((structure.end_dofs[j], 1.0),))
            out = out - view.couplings[axis, j] * np.gradient(speed, view.record.wave_step)
        return out
    spring, pattern = structure.spring_pairs.index((at, at + 1)), ((at + 1, 1.0), (at, -1.0))
    k, d = float(view.springs[spring]), float(view.dampers[spring])
    return out + k * view.wave(pattern) + d * view.velocity(pattern)


__all__ = ["centred", "follow_motor", "torque_of_chain"]
