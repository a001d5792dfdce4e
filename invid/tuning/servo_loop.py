"""The cascade of a drive at its motor encoder, its values, and its response and state space by
python-control.

Each cycle T of the drive, from the position q that the motor encoder shows (v its backward difference) and
the commanded motion r:

    u = N(z) · K_v · (1 + T / (T_i (1 − z⁻¹))) · (K_p (r − q) + ṙ − v) + feedforward,    N: notch filters.

u acts after ``dead_cycles`` whole cycles and is held over one. A PI velocity controller under a P position
controller is the same law as a PID position controller with velocity feedforward (``as_pid``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from typing import Annotated, Any

import control
import numpy as np
from annotated_types import Gt
from pydantic import BeforeValidator
from scipy.signal import bilinear

from invid.exchange.linear_plant import LinearPlant
from invid.exchange.statespace import state_space
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
    top, bottom = ([1.0, 2 * d * warped, warped**2] for d in (notch.zero_damping, notch.pole_damping))
    b, a = bilinear(top, bottom, 1.0 / cycle)
    return frozen_float(b), frozen_float(a)


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


def _sections(gains: Gains, timing: DriveTiming) -> list[tuple[Float64, Float64]]:
    """Numerators and denominators in z⁻¹ from the speed that is missed to torque: integral, then notches."""
    if math.isinf(gains.integral_time):  # no pole that its zero would only seem to cancel
        pi = np.array([gains.velocity_gain]), np.ones(1)
    else:
        pi = (
            gains.velocity_gain * np.array([1.0 + timing.cycle / gains.integral_time, -1.0]),
            np.array([1.0, -1.0]),
        )
    return [pi, *(notch.coefficients(timing.cycle) for notch in gains.notches)]


def _place_section(gains: Gains, timing: DriveTiming) -> tuple[Float64, Float64]:
    """The same from the place that is missed to the speed that is."""
    return np.array([gains.position_gain + 1.0 / timing.cycle, -1.0 / timing.cycle]), np.array([1.0, 0.0])


def controller_response(gains: Gains, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F,) torque per position error at ω [rad/s], without dead time and hold."""
    return speed_response(gains, timing, omega) * _response([_place_section(gains, timing)], timing, omega)


def speed_response(gains: Gains, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F,) torque per speed error at ω [rad/s], without dead time and hold."""
    return _response(_sections(gains, timing), timing, omega)


def _response(sections: Sequence[tuple[Float64, Float64]], timing: DriveTiming, omega: Float64) -> Complex128:
    late = np.exp(-1j * np.asarray(omega) * timing.cycle)
    out: Complex128 = np.ones(late.shape, dtype=np.complex128)
    for b, a in sections:
        out = out * np.polyval(b[::-1], late) / np.polyval(a[::-1], late)
    return out


def held_plant_response(plant: LinearPlant, timing: DriveTiming, omega: Float64) -> Complex128:
    """(F, M, M) motor positions per torque commanded: plant, lag, hold over a cycle and dead time.

    Images of the sampling are left out; whether a loop is stable is asked of ``closed_loop``, which is exact.
    """
    dead = np.array([timing.cycles(d) for d in plant.delay]) * timing.cycle
    w = np.asarray(omega)[:, None]
    hold = np.exp(-1j * w * (dead + timing.cycle / 2.0)) * np.sinc(w * timing.cycle / 2.0 / np.pi)
    result: Complex128 = plant.response(omega) * hold[:, None, :]
    return result


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A machine under its drives: poles in z, and the response of its loads to torques on them."""

    poles: Complex128
    cycle: float
    load_compliance: Any = field(repr=False)
    """``control.StateSpace`` from a torque at each load to its position (M inputs, M outputs)."""

    @property
    def is_stable(self) -> bool:
        """Whether all poles lie within the unit circle."""
        return bool(np.abs(self.poles).max() < 1.0)

    def modes(self) -> tuple[Float64, Float64]:
        """Frequencies [Hz] and damping ratios of the poles that oscillate, by frequency."""
        inside = self.poles[(np.abs(self.poles) > 1e-6) & (self.poles.imag > 1e-9)]
        s = np.log(inside) / self.cycle
        order = np.argsort(np.abs(s))
        size = np.abs(s[order])
        return size / (2 * np.pi), -s[order].real / size


def closed_loop(plant: LinearPlant, gains: tuple[Gains, ...], timing: DriveTiming) -> ClosedLoop:
    """Exact sampled loops of all axes on the linear plant: torques held over a cycle and late by whole
    cycles."""
    motors, n = len(plant.motors), plant.mass.shape[0]
    system = state_space(plant)
    ends = [int(i) for i in plant.chains.end_dofs]
    push = np.zeros((system.a.shape[0], motors))
    push[n : 2 * n] = np.linalg.solve(plant.mass, np.eye(n)[:, ends])
    loads = np.zeros((motors, system.a.shape[0]))
    loads[np.arange(motors), ends] = 1.0
    b, c = np.hstack([system.b, push]), np.vstack([system.c, loads])
    sampled = control.sample_system(
        control.ss(system.a, b, c, np.zeros((2 * motors, 2 * motors))), timing.cycle, "zoh"
    )
    late = [_late(controller(g, timing), timing.cycles(d)) for g, d in zip(gains, plant.delay, strict=True)]
    back = control.append(*late, *([control.ss([], [], [], [[0.0]], timing.cycle)] * motors))
    closed = control.feedback(sampled, back)
    compliance = control.ss(
        closed.A, closed.B[:, motors:], closed.C[motors:], closed.D[motors:, motors:], timing.cycle
    )
    return ClosedLoop(np.asarray(closed.poles()), timing.cycle, compliance)


def controller(gains: Gains, timing: DriveTiming) -> Any:
    """``control.StateSpace`` of ``controller_response``."""
    return speed_controller(gains, timing) * _state_space(*_place_section(gains, timing), timing)


def speed_controller(gains: Gains, timing: DriveTiming, dead_cycles: int = 0) -> Any:
    """``control.StateSpace`` of ``speed_response``, its output ``dead_cycles`` later."""
    parts = [_state_space(b, a, timing) for b, a in _sections(gains, timing)]
    return _late(reduce(lambda before, part: part * before, parts), dead_cycles)


def _state_space(b: Float64, a: Float64, timing: DriveTiming) -> Any:
    return control.tf2ss(control.tf(b, a, timing.cycle))


def _late(system: Any, cycles: int) -> Any:
    """The system with its output ``cycles`` cycles later."""
    if cycles == 0:
        return system
    shift = control.ss(np.eye(cycles, k=-1), np.eye(cycles)[:, :1], np.eye(cycles)[-1:], [[0.0]], system.dt)
    return shift * system
