"""State space of the cascade of ``servo_loop``, and of a machine under it, by python-control."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import control
import numpy as np

from invid.exchange.linear_plant import LinearPlant
from invid.exchange.statespace import state_space
from invid.numerics.arrays import Complex128, Float64
from invid.tuning.servo_loop import DriveTiming, Gains, place_section, sections

DOMINANT = 0.3
"""Empirical: share of the largest amplitude from which a mode counts as one of a load."""


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


def load_mode(loop: ClosedLoop, axis: int) -> tuple[float, float] | None:
    """Frequency [Hz] and damping ratio of the lowest mode in which the load of an axis swings; ``None`` where
    nothing does."""
    system = loop.load_compliance
    poles, right = np.linalg.eig(system.A)
    left = np.linalg.pinv(right)
    size: Float64 = np.abs((system.C[axis] @ right) * (left @ system.B[:, axis]))
    swinging = (poles.imag > 1e-9) & (np.abs(poles) > 1e-6)
    if not swinging.any():
        return None
    s: Complex128 = np.log(poles[swinging]) / loop.cycle
    size = size[swinging]
    large = s[size >= DOMINANT * size.max()]
    lowest = large[np.argmin(np.abs(large))]
    return float(np.abs(lowest)) / (2 * np.pi), float(-lowest.real / np.abs(lowest))


def controller(gains: Gains, timing: DriveTiming) -> Any:
    """``control.StateSpace`` of ``controller_response``."""
    return speed_controller(gains, timing) * _state_space(*place_section(gains, timing), timing)


def speed_controller(gains: Gains, timing: DriveTiming, dead_cycles: int = 0) -> Any:
    """``control.StateSpace`` of ``speed_response``, its output ``dead_cycles`` later."""
    parts = [_state_space(b, a, timing) for b, a in sections(gains, timing)]
    return _late(reduce(lambda before, part: part * before, parts), dead_cycles)


def _state_space(b: Float64, a: Float64, timing: DriveTiming) -> Any:
    return control.tf2ss(control.tf(b, a, timing.cycle))


def _late(system: Any, cycles: int) -> Any:
    """The system with its output ``cycles`` cycles later."""
    if cycles == 0:
        return system
    shift = control.ss(np.eye(cycles, k=-1), np.eye(cycles)[:, :1], np.eye(cycles)[-1:], [[0.0]], system.dt)
    return shift * system
