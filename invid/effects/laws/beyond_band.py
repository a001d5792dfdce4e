"""Inner motion beyond the band in use, which is not measured: the response to a law's own force there.

Inner masses are reconstructed on the lines in use, up to a few times the highest excited one. A law of
their motion acts on all of it. What moves them beyond is its own force, against their inertia and the springs
beside them: without it a spring that stiffens seemed up to 2 % stiffer than it was.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from invid.effects.motion import View
from invid.model.place import Pattern, Place
from invid.numerics.arrays import Complex128, Float64

PASSES = 3
"""Half steps towards agreement of motion and force: an eighth of the disagreement is left."""
LEAST_DIFFERENCE = 0.5
"""Least difference of inertia and spring, over the larger, on a line that responds (physical): nearer to a
resonance beyond the band the damping decides, and half steps would not settle."""


def beyond_band(view: View, place: Place) -> Float64 | None:
    """(n//2 + 1,) receptance along a place on the waves' lines above those in use.

    ``None`` for motors, whose motion is measured, and between axes.
    """
    pattern, springs = place.pattern(view.structure), view.structure.spring_pairs
    at = [dof for dof, _ in pattern]
    if place.other >= 0 or (len(at) == 1 and at[0] in view.structure.motor_dofs):
        return None
    springs_beside = [
        q for q, ends in enumerate(springs) if (set(ends) == set(at) if len(at) == 2 else at[0] in ends)
    ]
    stiffness = float(sum(view.springs[q] for q in springs_beside))
    lightness = float(sum(1.0 / view.masses[dof] for dof in at))
    omega = view.record.wave_omega
    inertia = omega**2 / lightness
    is_clear = np.abs(stiffness - inertia) >= LEAST_DIFFERENCE * np.maximum(stiffness, inertia)
    is_used = (np.arange(omega.size) > view.record.lines[-1]) & is_clear
    out: Float64 = np.where(is_used, 1.0 / np.where(is_used, stiffness - inertia, 1.0), 0.0)
    return out


def solve_beyond_band(
    view: View, pattern: Pattern, compliance: Float64, resisting: Callable[[], Float64]
) -> Float64:
    """(n,) resistance in agreement with the motion beyond the band that it causes."""
    return solve_with_motion(view, pattern, compliance, resisting)[0]


def solve_with_motion(
    view: View, pattern: Pattern, compliance: Float64, resisting: Callable[[], Float64]
) -> tuple[Float64, Complex128]:
    """(n,) resistance, and (n//2 + 1,) lines of the motion beyond the band at which it was last evaluated."""
    wave = resisting()
    hidden: Complex128 = np.zeros(compliance.size, dtype=complex)
    try:
        for _ in range(PASSES):
            hidden = motion_of_force(view, compliance, wave)
            view.set_hidden_motion(pattern, hidden)
            wave = 0.5 * (wave + resisting())
    finally:
        view.set_hidden_motion(pattern, None)
    return wave, hidden


def motion_of_force(view: View, compliance: Float64, force: Float64) -> Complex128:
    """(n//2 + 1, …) lines of the motion beyond the band that a force (n, …) causes."""
    if view.record.transient:  # what jumps from the end to the start would ring at both
        ramp = np.linspace(-0.5, 0.5, force.shape[0])
        force = force - np.multiply.outer(ramp, force[-1] - force[0])
    out: Complex128 = -(np.fft.rfft(force, axis=0).T * compliance).T
    return out
