"""The cascade of a drive at its motor encoder: its values and its response.

Each cycle T of the drive, from the position q that the motor encoder shows (v its backward difference) and
the commanded motion r:

    u = N(z) · K_v · (1 + T / (T_i (1 − z⁻¹))) · (K_p (r − q) + ṙ − v) + feedforward,    N: notch filters.

u acts after ``dead_cycles`` whole cycles and is held over one. A PI velocity controller under a P position
controller is the same law as a PID position controller with velocity feedforward (``as_pid``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Gt
from pydantic import BeforeValidator

from invid.exchange.linear_plant import LinearPlant
from invid.numerics.arrays import Complex128, Float64, frozen_float

Positive = Annotated[float, Gt(0)]
"""Checked where a document is read."""


@dataclass(frozen=True)
class Notch:
    """A biquad (s² + 2 ζ_z ω s + ω²) / (s² + 2 ζ_p ω s + ω²): ``frequency`` ω/2π [Hz], depth ζ_z/ζ_p."""

    frequency: Positive
    zero_damping: Positive
    pole_damping: Positive

    def coefficients(self, cycle: float) -> tuple[Float64, Float64]:
        """Numerator and denominator (3,) in z⁻¹ at a cycle [s], warped so that the centre stays."""
        return _biquad(self, cycle)


@lru_cache(maxsize=4096)
def _biquad(notch: Notch, cycle: float) -> tuple[Float64, Float64]:
    w = 2 * np.pi * notch.frequency
    warped = 2.0 / cycle * np.tan(min(w * cycle / 2.0, 1.5))
    # Tustin's rule: s = k (1 − z⁻¹) / (1 + z⁻¹)
    k = 2.0 / cycle
    square, sides = k**2 + warped**2, 2.0 * (warped**2 - k**2)
    zero, pole = (2.0 * d * warped * k for d in (notch.zero_damping, notch.pole_damping))
    b, a = [square + zero, sides, square - zero], [square + pole, sides, square - pole]
    return frozen_float(np.array(b) / a[0]), frozen_float(np.array(a) / a[0])


@dataclass(frozen=True)
class Gains:
    """Values of one axis' loops.

    ``velocity_gain`` K_v [N·m·s/rad or N·s/m], ``integral_time`` T_i [s], infinite: nothing is integrated,
    ``position_gain`` K_p [1/s].
    """

    velocity_gain: Positive
    integral_time: Annotated[Positive, BeforeValidator(lambda given: math.inf if given is None else given)]
    position_gain: Positive
    notches: tuple[Notch, ...] = ()

    def as_pid(self) -> tuple[float, float, float]:
        """P [N·m/rad], I [N·m/(rad·s)] and D [N·m·s/rad] of the same law as one PID position controller."""
        k, ki, kp = self.velocity_gain, 1.0 / self.integral_time, self.position_gain
        return k * (kp + ki), k * kp * ki, k


@dataclass(frozen=True)
class DriveTiming:
    """``cycle`` T [s] of the loops; ``dead_cycles`` from reading the encoder until the torque is
    commanded."""

    cycle: float = 0.001
    dead_cycles: int = 1

    def cycles(self, delay: float) -> int:
        """Whole cycles until the torque acts, with the delay [s] that was identified; never too few."""
        return self.dead_cycles + max(0, int(np.ceil(delay / self.cycle - 1e-6)))

    def total(self, delay: float, lag: float) -> float:
        """T_Σ [s]: dead time, half a cycle of hold, half of the difference quotient, lag of the torque."""
        return (self.cycles(delay) + 1.0) * self.cycle + lag


def sections(gains: Gains, timing: DriveTiming) -> list[tuple[Float64, Float64]]:
    """Numerators and denominators in z⁻¹ from the speed that is missed to torque: integral, then notches."""
    if math.isinf(gains.integral_time):  # no pole that its zero would only seem to cancel
        pi = np.array([gains.velocity_gain]), np.ones(1)
    else:
        pi = (
            gains.velocity_gain * np.array([1.0 + timing.cycle / gains.integral_time, -1.0]),
            np.array([1.0, -1.0]),
        )
    return [pi, *(notch.coefficients(timing.cycle) for notch in gains.notches)]


def place_section(gains: Gains, timing: DriveTiming) -> tuple[Float64, Float64]:
    """The same from the place that is missed to the speed that is."""
    return np.array([gains.position_gain + 1.0 / timing.cycle, -1.0 / timing.cycle]), np.array([1.0, 0.0])


def controller_response(gains: Gains, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F,) torque per position error at ω [rad/s], without dead time and hold."""
    return speed_response(gains, timing, omega) * _response([place_section(gains, timing)], timing, omega)


def speed_response(gains: Gains, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F,) torque per speed error at ω [rad/s], without dead time and hold."""
    return _response(sections(gains, timing), timing, omega)


def _response(sections: Sequence[tuple[Float64, Float64]], timing: DriveTiming, omega: Float64) -> Complex128:
    late = np.exp(-1j * np.asarray(omega) * timing.cycle)
    out: Complex128 = np.ones(late.shape, dtype=np.complex128)
    for b, a in sections:
        out = out * np.polyval(b[::-1], late) / np.polyval(a[::-1], late)
    return out


def held_plant_response(plant: LinearPlant, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F, M, M) motor positions per torque commanded: plant, lag, hold over a cycle and dead time.

    Images of the sampling are left out; whether a loop is stable is asked of ``closed_loop``, which is
    exact.
    """
    dead = np.array([timing.cycles(d) for d in plant.delay]) * timing.cycle
    w = np.asarray(omega)[:, None]
    hold = np.exp(-1j * w * (dead + timing.cycle / 2.0)) * np.sinc(w * timing.cycle / 2.0 / np.pi)
    result: Complex128 = plant.response(omega) * hold[:, None, :]
    return result
