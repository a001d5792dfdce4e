"""Which axes the excitation of a record drives, and which are only held."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.linear_algebra import real_rows

HELD = 0.01
"""Share of an axis' torque power that a hold law may leave: a driven axis' torque is the plant's, with
resonances that no −(P + jωD)θ has. A guess; beside it, noise."""
LINES = 8
"""Lines that a hold law is judged on at least: on fewer, anything is −(P + jωD)θ."""
DECADE = 2.0
"""Ratio of the highest to the lowest of these lines: in a narrow band a driven mass, −ω²mθ, is like a
spring."""


def driven_axes(
    excited_axis: int, position: Complex128, torque: Complex128, omega: Float64, excited: Bool, floor: Float64
) -> Bool:
    """(M,) axes that the excitation drives: the one that is named, or all but those that are only held.

    Where none is named (−1) an axis whose recorded torque is −(P + jωD)·position with P and D ≥ 0 is held,
    not driven: a hold takes power out of the machine. ``position`` and ``torque`` are (F, M), ``floor`` is
    (2M,).
    """
    motors = torque.shape[1]
    if 0 <= excited_axis < motors:
        driven: Bool = np.arange(motors) == excited_axis
        return driven
    w = omega[excited]
    if motors == 1 or w.size < LINES or w.max() < DECADE * w.min():
        return np.ones(motors, dtype=bool)
    loudest = int(
        np.argmax(np.sum(np.abs(torque[excited]) ** 2, axis=0) / np.maximum(floor[motors:], 1e-300))
    )
    held = [
        i != loudest and _only_held(w, position[excited, i], torque[excited, i], floor[[i, motors + i]])
        for i in range(motors)
    ]
    return ~np.array(held)


def _only_held(omega: Float64, position: Complex128, torque: Complex128, floor: Float64) -> bool:
    """Whether one axis' torque is that of a hold, by least squares of −(P + jωD)θ."""
    power = float(np.sum(np.abs(torque) ** 2))
    # The mean power of noise lines has a relative error of 1/√lines; five times it is no noise.
    if power < 5.0 * torque.size * float(floor[1]):
        return False
    rows = np.stack((-position, -1j * omega * position), axis=1)
    both, goal = real_rows(rows), real_rows(torque)
    law = np.linalg.lstsq(both, goal, rcond=None)[0]
    left = float(np.sum((goal - both @ law) ** 2))
    stiffness = float(law[0] ** 2 + np.mean(omega**2) * law[1] ** 2)
    noise = torque.size * (float(floor[1]) + stiffness * float(floor[0]))
    return bool(law[0] > 0 and law[1] >= 0 and left < max(HELD * power, 3.0 * noise) and left < 0.5 * power)
