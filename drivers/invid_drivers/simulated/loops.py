"""The position and velocity loops of a simulated drive, as they come or as its config states them."""

from __future__ import annotations

import math

from pydantic import Field

from invid.config.experiments import Strict
from invid.numerics.arrays import Float64
from invid.tuning.servo_loop import Notch
from invid_drivers.simulated import kernel

SAMPLED_S = 0.001
"""Cycle of loops that a config states, unless it says another: that of `invid tune`."""


class LoopValues(Strict):
    """Values of the loops at the axis; units as ``invid tune`` writes them."""

    velocity_gain: float = Field(ge=0)
    """K_v [N·m·s/rad or N·s/m]"""
    position_gain: float = Field(ge=0)
    """K_p [1/s]"""
    integral_time: float = Field(default=math.inf, gt=0)
    """T_i [s]; infinite: nothing is integrated."""
    viscous: float = Field(default=0.0, ge=0)
    """Feedforward of speed [N·m·s/rad or N·s/m]"""
    inertia: float = Field(default=0.0, ge=0)
    """Feedforward of acceleration [kg·m² or kg]"""
    notches: list[Notch] = Field(default_factory=list, max_length=kernel.NOTCH_COUNT)


def put_into(row: Float64, values: LoopValues, cycle_s: float) -> None:
    """Give the kernel's command row the loops' values and their cycle [s]; 0: they run in each sub-step."""
    row[kernel.VELOCITY_GAIN], row[kernel.POSITION_GAIN] = values.velocity_gain, values.position_gain
    row[kernel.RESET], row[kernel.CYCLE] = 1.0 / values.integral_time, cycle_s
    row[kernel.FEED_VISCOUS], row[kernel.FEED_INERTIA] = values.viscous, values.inertia
    filters = row[kernel.NOTCHES :].reshape(kernel.NOTCH_COUNT, kernel.NOTCH_SIZE)
    filters[:] = [1.0, 0.0, 0.0, 0.0, 0.0]
    if cycle_s:
        for k, notch in enumerate(values.notches):
            b, a = notch.coefficients(cycle_s)
            filters[k] = [*b, *a[1:]]
