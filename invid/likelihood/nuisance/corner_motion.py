"""Motion of the motors beyond the band, from their own equation: the corners that friction makes.

An encoder's errors hide a motor's motion from some frequency on. What is hidden is small, but dry friction
turns over within it: the instant of a reversal is read from the corner that the reversal itself makes. There
a motor is no more than its own inertia, and its motion follows from its drive's torque and its friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.laws.motor_balance import centred
from invid.effects.motion import View
from invid.likelihood.evaluation import record_views
from invid.likelihood.joint_fit import JointFit
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord


def complete_motion(records: Sequence[SpectralRecord], fitted: JointFit) -> list[SpectralRecord]:
    """The records with the motors' waves completed where noise hides them, by the friction of a fit."""
    return [_completed(v, fitted) for v in record_views(fitted.layout, records, fitted.p)]


def _completed(view: View, fitted: JointFit) -> SpectralRecord:
    """One record, on both its grids."""
    if view.record.fine is None:
        return _complete(view, fitted)
    done = _complete(view.on_fine_grid(), fitted).on_coarse_grid()
    # What was found of the record since, as its scatter, stands on the coarse one alone.
    return replace(
        view.record,
        motor_wave=done.motor_wave,
        motor_velocity=done.motor_velocity,
        unseen=done.unseen,
        fine=done.fine,
    )


def _complete(view: View, fitted: JointFit) -> SpectralRecord:
    """One record with its motors' motion completed."""
    record = view.record
    if not record.unseen.size:
        return record
    hidden = np.zeros_like(record.motor_velocity)
    for axis in range(hidden.shape[1]):
        acting = centred(view.drive_means(axis).mean(axis=1), view) - force_at_motor(view, fitted, axis)
        if record.transient:  # what jumps from the end to the start would ring at both
            acting -= np.linspace(-0.5, 0.5, acting.size) * (acting[-1] - acting[0])
        lightness = 1.0 / float(view.masses[view.structure.motor_dofs[axis]])
        hidden[:, axis] = lightness * record.unseen_speed(acting, axis)
    lines, omega = np.fft.rfft(hidden, axis=0), record.wave_omega[:, None]
    lines = np.divide(lines, 1j * omega, out=np.zeros_like(lines), where=omega > 0)
    return replace(
        record,
        motor_velocity=record.motor_velocity + hidden,
        motor_wave=record.motor_wave + np.fft.irfft(lines, record.samples, axis=0),
        unseen=np.zeros((0, 0)),
    )


def force_at_motor(view: View, fitted: JointFit, axis: int) -> Float64:
    """(n,) resistance of the causes at a motor over time, by their laws."""
    total = np.zeros(view.record.samples)
    for term, x in zip(fitted.candidate.terms, fitted.candidate.x, strict=True):
        place, effect = term.place, term.effect
        is_here = place.kind == "mass" and (place.axis, place.number) == (axis, 1)
        if is_here and isinstance(effect, ForceEffect):
            count = len(effect.coefficients)
            total += effect.law(view, place, x[count:].tolist()) @ np.asarray(x[:count])
    return total


__all__ = ["complete_motion", "force_at_motor"]
