"""The catalogue of causes, one a module."""

from invid.effects import (
    asymmetric_friction,
    backlash,
    cogging,
    coulomb_friction,
    coupling_stiffness,
    cubic_stiffness,
    encoder_eccentricity,
    extra_mode,
    gravity,
    parameter_drift,
    payload_change,
    presliding_friction,
    spring_hysteresis,
    stribeck_friction,
    torque_gain,
    torque_lag,
    torque_offset,
    torque_saturation,
    transmission_error,
    viscous_friction,
)
from invid.effects.base import Effect, Family, Place, Shape

CATALOGUE: tuple[Effect, ...] = (
    viscous_friction.EFFECT,
    coulomb_friction.EFFECT,
    stribeck_friction.EFFECT,
    presliding_friction.EFFECT,
    asymmetric_friction.EFFECT,
    torque_offset.EFFECT,
    cogging.EFFECT,
    gravity.EFFECT,
    torque_lag.EFFECT,
    torque_gain.EFFECT,
    torque_saturation.EFFECT,
    encoder_eccentricity.EFFECT,
    cubic_stiffness.EFFECT,
    backlash.EFFECT,
    spring_hysteresis.EFFECT,
    transmission_error.EFFECT,
    extra_mode.EFFECT,
    coupling_stiffness.EFFECT,
    payload_change.EFFECT,
    parameter_drift.EFFECT,
)
"""Causes that compete as columns of the missing torque. ``torque_delay`` and ``dropped_samples`` are decided
from the fit's time offset and from the raw samples (``invid.discrepancy``)."""

__all__ = ["CATALOGUE", "Effect", "Family", "Place", "Shape"]
