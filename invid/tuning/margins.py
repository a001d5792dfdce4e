"""Margins of a loop broken at the torque of one axis while all other axes are under control, over many draws.

With L the loop so broken and S = 1/(1 + L): peak of sensitivity max |S|, gain margin (the least factor, up or
down, that reaches −1) and phase margin (the least angle that does). S is the diagonal of (I + K G)⁻¹ of all
axes, so that no axis is judged alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from invid.exchange.linear_plant import LinearPlant
from invid.model.matrices import natural_frequencies
from invid.numerics.arrays import Complex128, Float64
from invid.tuning.closed_loop import closed_loop
from invid.tuning.servo_loop import DriveTiming, Gains, controller_response, held_plant_response

SEEN = 0.02
"""Empirical: least share of a mode's motion at a motor by which it counts as seen there."""
BASE_POINTS = 320
_AROUND = np.concatenate([-np.geomspace(0.3, 3e-4, 8), np.geomspace(3e-4, 0.3, 8)])
"""Relative places of further points around a mode; not on it, where an undamped one has no response."""


@dataclass(frozen=True, eq=False)
class Margins:
    """Worst of all draws for one axis.

    ``gain`` as a factor ≥ 1, ``phase`` [°], ``sensitivity`` max |S|; ``unstable`` is the share of draws
    that are unstable with all loops closed, ``kept`` the share whose peak of sensitivity is within the
    promise. ``ripple`` is the rms torque [N·m or N] that counts of the encoders make, NaN where they are not
    known.
    """

    gain: float
    phase: float
    sensitivity: float
    unstable: float
    kept: float
    ripple: float = math.nan


@dataclass(frozen=True, eq=False)
class DrawnPlants:
    """Plants with their responses: ``omega`` (D, F) [rad/s], each draw's own, and ``response`` (D, F, M,
    M)."""

    plants: tuple[LinearPlant, ...]
    timing: DriveTiming
    omega: Float64
    response: Complex128

    def controllers(self, gains: Sequence[Gains]) -> Complex128:
        """(D, F, M)."""
        return np.stack([controller_response(g, self.timing, self.omega) for g in gains], axis=-1)

    def behind_axis(self, axis: int, gains: Sequence[Gains]) -> Complex128:
        """(D, F) motor position per torque of an axis while the others are under control."""
        k: Any = self.controllers(gains)
        k[..., axis] = 0.0
        loops: Any = np.eye(len(gains)) + self.response * k[..., None, :]
        return np.asarray(np.linalg.solve(loops, self.response[..., axis, None])[..., axis, 0], dtype=complex)

    def loops(self, gains: Sequence[Gains]) -> Complex128:
        """(D, F, M) loop of each axis broken at its torque."""
        k = self.controllers(gains)
        whole: Any = np.linalg.inv(np.eye(len(gains)) + k[..., :, None] * self.response)
        return np.asarray(1.0 / np.diagonal(whole, axis1=-2, axis2=-1) - 1.0, dtype=complex)

    def ripple(self, gains: Sequence[Gains], counts: Float64) -> Float64:
        """(D, M) rms torque that white noise of an encoder's count [rad or m], c/√12, makes in closed loop.

        NaN where a count (M,) is not known. In motion a count is such noise (Widrow and Kollár 2008); at rest
        it is less.
        """
        k = self.controllers(gains)
        loops: Any = np.eye(len(gains)) + k[..., :, None] * self.response
        torque: Any = np.abs(np.linalg.solve(loops, k[..., :, None] * np.eye(len(gains)))) ** 2
        power = (torque * (counts**2 / 12.0)).sum(axis=-1)
        mean = np.trapezoid(power, self.omega[..., None], axis=1) * self.timing.cycle / np.pi
        return np.asarray(np.sqrt(mean), dtype=float)


def drawn_plants(
    plants: Sequence[LinearPlant], timing: DriveTiming, poles: Sequence[Float64] = ()
) -> DrawnPlants:
    """Responses of plants on a grid to half the sampling frequency that is dense around their modes, and
    around ``poles`` [rad/s], an array for each plant."""
    rows = [frequency_grid(p, timing, poles[k] if len(poles) else np.zeros(0)) for k, p in enumerate(plants)]
    most = max(r.size for r in rows)
    omega = np.stack([np.concatenate([r, np.full(most - r.size, r[-1])]) for r in rows])
    response = np.stack([held_plant_response(p, timing, w) for p, w in zip(plants, omega, strict=True)])
    return DrawnPlants(tuple(plants), timing, omega, response)


def held_modes(plant: LinearPlant, motors: Sequence[int]) -> Float64:
    """Natural frequencies [rad/s] with these motors (indices of axes) held, elastic ones alone."""
    free = np.setdiff1d(np.arange(plant.mass.shape[0]), [plant.motors[i] for i in motors])
    if free.size == 0:
        return np.zeros(0)
    at = np.ix_(free, free)
    found = natural_frequencies(plant.mass[at], plant.stiffness[at])
    return np.asarray(found[found > 1e-3 * max(found[-1], 1e-9)])


def seen_modes(plant: LinearPlant, axis: int) -> tuple[float | None, float | None]:
    """Antiresonance and resonance [Hz] that a motor shows first while the other motors are held.

    The antiresonance is the lowest mode with this motor held too that pulls at it, the resonance the lowest
    above it in which the motor moves, each with at least ``SEEN`` of what all modes do; ``None`` where
    nothing swings.
    """
    own = plant.motors[axis]
    free = np.setdiff1d(np.arange(plant.mass.shape[0]), [m for m in plant.motors if m != own])
    inner = free[free != own]
    if inner.size == 0:
        return None, None
    squares, shapes = scipy.linalg.eigh(plant.stiffness[np.ix_(free, free)], plant.mass[np.ix_(free, free)])
    held, inside = scipy.linalg.eigh(plant.stiffness[np.ix_(inner, inner)], plant.mass[np.ix_(inner, inner)])
    size = np.abs(shapes[free == own][0]) ** 2
    pull = np.abs(plant.stiffness[own, inner] @ inside) ** 2
    low = held[pull > SEEN * pull.sum()]
    if low.size == 0:
        return None, None
    high = squares[(squares > low.min()) & (size > SEEN * size.sum())]
    antiresonance, resonance = (
        math.sqrt(float(x.min())) / (2 * math.pi) if x.size else None for x in (low, high)
    )
    return antiresonance, resonance


def frequency_grid(plant: LinearPlant, timing: DriveTiming, poles: Float64) -> Float64:
    """(F,) ascending ω [rad/s]."""
    highest = np.pi / timing.cycle
    elastic = plant.modes[plant.modes > 1e-3 * max(plant.modes[-1], 1e-9)]
    marks = np.concatenate([elastic, held_modes(plant, range(len(plant.motors))), poles])
    marks = marks[(marks > 0) & (marks < 0.95 * highest)]
    lowest = 0.02 * (marks.min() if marks.size else highest / 100.0)
    around = (marks[:, None] * (1.0 + _AROUND)).ravel()
    grid = np.concatenate([np.geomspace(lowest, 0.99 * highest, BASE_POINTS), around])
    return np.sort(grid[(grid >= lowest) & (grid <= 0.99 * highest)])


def axis_margins(loop: Complex128) -> tuple[Float64, Float64, Float64]:
    """(D,) gain margin, phase margin [°] and peak of sensitivity of loops (D, F)."""
    peak = np.abs(1.0 / (1.0 + loop)).max(axis=1)
    a, b = loop[:, :-1], loop[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = a.imag / (a.imag - b.imag)
        real = a.real + share * (b.real - a.real)
        crossing = (a.imag * b.imag < 0) & (real < 0)
        size = np.where(crossing, np.abs(real), np.nan)
        factor = np.where(crossing, np.maximum(size, 1.0 / size), np.inf)
        la, lb = np.log(np.abs(a)), np.log(np.abs(b))
        at = np.where(la * lb < 0, la / (la - lb), np.nan)
    turn = np.angle(b / a)
    angle = np.angle(-a) + np.nan_to_num(at) * turn
    phase = np.where(np.isfinite(at), np.abs(np.degrees(np.angle(np.exp(1j * angle)))), 180.0)
    return factor.min(axis=1), phase.min(axis=1), peak


def worst_margins(
    plants: Sequence[LinearPlant],
    gains: tuple[Gains, ...],
    timing: DriveTiming,
    promise: float,
    counts: Float64 | None = None,
) -> tuple[Margins, ...]:
    """Margins of every axis in the worst of ``plants``; ``promise`` is the peak of sensitivity to be kept,
    ``counts`` (M,) those of the encoders.
    """
    loops = [closed_loop(p, gains, timing) for p in plants]
    stable = np.array([loop.is_stable for loop in loops])
    poles = [2 * np.pi * loop.modes()[0] for loop in loops]
    most = max(p.size for p in poles)
    drawn = drawn_plants(plants, timing, [np.resize(p, most) if p.size else p for p in poles])
    broken = drawn.loops(gains)
    ripples = drawn.ripple(gains, np.full(len(gains), math.nan) if counts is None else counts).max(axis=0)
    out = []
    for i in range(len(gains)):
        gain, phase, peak = axis_margins(broken[..., i])
        kept = stable & (peak <= promise)
        unstable = 1.0 - float(stable.mean())
        if unstable:
            gain, phase, peak = np.ones(1), np.zeros(1), np.full(1, np.inf)
        sizes = float(gain.min()), float(phase.min()), float(peak.max())
        out.append(Margins(*sizes, unstable, float(kept.mean()), float(ripples[i])))
    return tuple(out)
