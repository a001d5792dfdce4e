"""Which records are large motions for rigid axes, and which are for the spectral diagnosis of chains."""

from __future__ import annotations

import numpy as np

from invid.errors import InvidError
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.recording.model import Kind, Recording
from invid.rigid_motion.fit import axis_powers, fit_terms
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import GRAVITY, Base, Term
from invid.signals.motion_record import motions_of
from invid.signals.timebase import resample_uniformly

SHAKING_RATE = 4.0
"""Reversals of velocity a second from which an axis is shaken, not moved. Empirical: at most 1.8 on the moves
of six arms of two links, 7.8 and more on 16 chains under noise or a stepped sine."""
LEFT_BY_SPRING = 0.25
"""Share of what friction, gravity and inertia leave on held-out rows that a spring to ground may leave
(empirical)."""
LEAST_WEIGHED = 1.0
"""Travel [rad] from which weight is told from a spring to ground (physical)."""


def is_trajectory(recording: Recording) -> bool:
    """Whether a recording is a motion for a rigid model with gravity, friction or a spring to ground.

    That is: velocity without position; moves and constant velocities that are no shaking, or of several axes
    that turn and are stated to be one mass each; and any record whose motor has no rigid mode. Periodic and
    swept excitation of a free axis is not.
    """
    experiments, masses = recording.experiments, recording.masses_per_axis
    if any(e.attributes.get("position_source") == "integrated_velocity" for e in experiments):
        return True
    if any(e.period_samples and e.periods >= 2 for e in experiments) or max(masses or (1,)) > 1:
        return False
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in experiments):
        return True
    is_made = all(e.kind in (Kind.CONSTANT_VELOCITY, Kind.OTHER) for e in experiments)
    if not is_made and recording.axis_count > 1:
        return False
    # Chains of one mass cannot hold an inertia that varies with the pose of another axis.
    is_stated = masses is not None and recording.axis_count > 1 and not recording.linear
    try:
        is_slow = is_made and (is_stated or reversal_rate(recording) < SHAKING_RATE)
        return bool(grounded_axes(recording)) or is_slow
    except InvidError:
        # Too short or too uneven even to look at: the chain diagnosis says what is missing.
        return False


def reversal_rate(recording: Recording) -> float:
    """Reversals a second of the velocity of the busiest axis, in the longest record.

    Beyond a tenth of its rms, because an encoder at rest flickers.
    """
    longest = max(recording.experiments, key=lambda e: e.samples)
    even = resample_uniformly(longest)
    most = 0.0
    for position in even.position.T:
        velocity = np.diff(position)
        sign = np.sign(velocity[np.abs(velocity) > 0.1 * np.sqrt(np.mean(velocity**2))])
        most = max(most, float(np.count_nonzero(np.diff(sign))) / (velocity.size * even.step))
    return most


def grounded_axes(recording: Recording) -> set[int]:
    """Axes that a spring ties to ground: no rigid mode, and a resonance inside the band.

    The spring must leave at most ``LEFT_BY_SPRING``.
    """
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in recording.experiments):
        return set()
    rows = Rows(motions_of(recording))
    found: set[int] = set()
    for i in range(recording.axis_count):
        plain = [Term(law, j) for law in (Base.INERTIA, Base.TIME_OFFSET) for j in range(rows.axes)]
        plain += [Term(part, i) for part in (Part.DRY, Part.VISCOUS, Part.OFFSET)]
        travel = np.ptp(np.concatenate([m.position[:, i] for m in rows.motions]))
        if not recording.linear and travel > LEAST_WEIGHED:
            plain.append(Term(GRAVITY, i))
        spring = Term(Base.GROUND_SPRING, i)
        before, after = fit_terms(rows, plain), fit_terms(rows, [*plain, spring])
        stiffness, mass = after.of(spring)[0][0], after.of(plain[i])[0][0]
        if stiffness <= 0 or mass <= 0:
            continue
        own = float(np.sqrt(stiffness / mass) / (2 * np.pi))
        slowest = 4.0 / max(e.duration for e in recording.experiments)
        inside = slowest < own < float(rows.motions[0].band.rows_hz[i])
        left, without = (axis_powers(rows, rows.judged, f.held_out)[i] for f in (after, before))
        found |= {i} if inside and left < LEFT_BY_SPRING * without else set()
    return found
