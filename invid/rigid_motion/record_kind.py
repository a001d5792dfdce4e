"""Which records are large motions for rigid axes, and which are for the spectral diagnosis of chains."""

from __future__ import annotations

import numpy as np

from invid.errors import InvidError
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.recording.model import Kind, Recording
from invid.rigid_motion.fit import axis_powers, fit_terms
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import GRAVITY, Base, Term, base_terms, extent, first_terms
from invid.signals.motion_record import find_band, prepare_rows
from invid.signals.timebase import resample_uniformly

LEAST_RIGID_SHARE = 0.8
"""Share of the torque, on rows kept out, that inertia, friction and gravity of a rigid axis make at
least. Empirical: 0.97 and more on the moves of three machines, 0.67 and less on the worst axis of ten chains
that noise or a stepped sine shook."""

SHAKING_RATE = 4.0
"""Reversals of velocity a second from which an axis is shaken, not moved. Empirical: at most 1.8 on the moves
of six arms of two links (one axis changes the inertia of the other, so that rigid axes alone account for a
tenth of the torque in one), 7.8 and more on 16 chains under noise or a stepped sine."""
LEFT_BY_SPRING = 0.25
"""Share of what friction, gravity and inertia leave on held-out rows that a spring to ground may leave
(empirical)."""
LEAST_WEIGHED = 1.0
"""Travel [rad] from which weight is told from a spring to ground (physical)."""


def is_trajectory(recording: Recording) -> bool:
    """Whether a recording is a motion for a rigid model with gravity, friction or a spring to ground.

    That is: velocity without position; moves and constant velocities that are no shaking, or whose torque
    rigid axes explain, or of several axes that turn and are stated to be one mass each; and any record whose
    motor has no rigid mode. Periodic and swept excitation of a free axis is not.
    """
    experiments = recording.experiments
    if any(e.attributes.get("position_source") == "integrated_velocity" for e in experiments):
        return True
    if any(e.period_samples and e.periods >= 2 for e in experiments):
        return False
    if recording.masses_per_axis is not None and max(recording.masses_per_axis) > 1:
        return False
    moves = (Kind.CONSTANT_VELOCITY, Kind.OTHER)
    try:
        if all(e.kind in moves for e in experiments):
            if all(e.kind is Kind.CONSTANT_VELOCITY for e in experiments):
                return True
            if grounded_axes(recording):
                return True
            # Chains of one mass cannot hold an inertia that varies with the pose of another axis.
            if recording.masses_per_axis is not None and recording.axis_count > 1 and not recording.linear:
                return True
            return (
                reversal_rate(recording) < SHAKING_RATE or rigid_torque_share(recording) > LEAST_RIGID_SHARE
            )
        return recording.axis_count == 1 and bool(grounded_axes(recording))
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


def rigid_torque_share(recording: Recording) -> float:
    """Share of the torque's power that rigid axes with friction and gravity explain on held-out rows, worst
    axis."""
    band = find_band(recording.experiments)
    motions = [prepare_rows(e, band) for e in recording.experiments]
    rows, reach = Rows(motions), extent(motions, not recording.linear)
    remainder = fit_terms(rows, [*base_terms(reach, set()), *first_terms(reach, set())]).held_out
    every = np.ones(rows.torque.size, dtype=np.bool_)
    left, power = (axis_powers(rows, every, x) for x in (remainder, rows.torque))
    return float(np.min(1.0 - left / np.where(power > 0, power, np.inf)))


def grounded_axes(recording: Recording) -> set[int]:
    """Axes that a spring ties to ground: no rigid mode, and a resonance inside the band.

    The spring must leave at most ``LEFT_BY_SPRING``.
    """
    if all(e.kind is Kind.CONSTANT_VELOCITY for e in recording.experiments):
        return set()
    band = find_band(recording.experiments)
    rows = Rows([prepare_rows(e, band) for e in recording.experiments])
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
        inside = slowest < own < float(band.rows_hz[i])
        left, without = (axis_powers(rows, rows.judged, f.held_out)[i] for f in (after, before))
        if inside and left < LEFT_BY_SPRING * without:
            found.add(i)
    return found
