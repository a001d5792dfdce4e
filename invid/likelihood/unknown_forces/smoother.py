"""Motion of every coordinate and force at every place over time: the best linear estimate of both.

With S the covariance of the missing torque r at the fitted numbers

    force at a place     f̂_p = q_p g H_pᴴ S⁻¹ r
    motor motion         θ̂ = θ − C_θ Zᴴ S⁻¹ r
    inner motion         q = Vᵀθ̂ − X(laws + ends − Σ b_p f̂_p)

Where a place is well modelled this is the motion that follows from the motor's; where it is not, it is read
from the torque (the paper's peeling, after equation 22). There is no fixed point, and nothing chaotic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.likelihood.unknown_forces.forces import MissingNoise, colours, missing_noise
from invid.likelihood.unknown_forces.slope import ends_numbers
from invid.likelihood.unknown_forces.stack import Stack
from invid.likelihood.unknown_forces.value import Problem, Value, along, torque_scales
from invid.model.plant import Condensed, Plant
from invid.numerics.arrays import Complex128, Float64
from invid.signals.record import line_weight, parabola

OVERSAMPLING = 4
"""Least instants for each line of a grid on which the slope of a law stands: its product with motion on those
lines reaches twice as far."""


@dataclass(frozen=True, eq=False)
class SmoothedStack:
    """Motion in the records of one stack.

    ``lines`` (R, A, n) of every coordinate; ``jump`` (R, n) and ``bend`` (R, n) of its position and
    velocity from a record's start to its end; ``ends`` (R, 2n) numbers of deviation one that make them, of
    which ``root`` (2n, 2n) makes M·Δq̇ + C·Δq and M·Δq over 2/T; ``force`` (R, A, P) unknown forces; ``plant``
    that of the fit. ``missing`` (R, A, M) is the motors' missing torque on all lines, ``sensors`` (A, M) the
    power that the sensors alone make of it. ``condensed`` and ``noise``: plant and covariance there;
    ``vectors`` (n, P) the places of forces, ``position_noise`` (M,) of the readings.
    """

    stack: Stack
    lines: Complex128
    jump: Float64
    bend: Float64
    ends: Float64
    root: Float64
    force: Complex128
    plant: Plant
    missing: Complex128
    sensors: Float64
    condensed: Condensed
    noise: MissingNoise
    vectors: Float64
    position_noise: Float64

    @cached_property
    def grid(self) -> int:
        """Points of the records' grids of motion, less one."""
        return int(self.stack.records[0].motion.position.shape[0] - 1)

    @property
    def omega(self) -> Float64:
        """(A,) lines [rad/s]."""
        return self.stack.records[0].wide

    @cached_property
    def weight(self) -> Float64:
        """(A,) of the lines in sums of squares."""
        return line_weight(self.omega)

    @cached_property
    def stride(self) -> int:
        """Most instants between two of a coarse grid of time with ``OVERSAMPLING`` of them a line."""
        most = max(1, self.grid // (OVERSAMPLING * self.omega.size))
        return max(k for k in range(1, most + 1) if self.grid % k == 0)

    def coarse_wave(self, lines: Complex128) -> Float64:
        """(…, k) wave of lines (…, A) on the coarse grid."""
        count = self.grid // self.stride
        return np.asarray(np.fft.irfft(lines, count) * (count / 2), dtype=np.float64)

    def coarse_lines(self, wave: Float64) -> Complex128:
        """(…, A) lines of a wave on the coarse grid."""
        lines = np.fft.rfft(wave)[..., : self.omega.size] * (2.0 / wave.shape[-1])
        return np.asarray(lines, dtype=np.complex128)

    def noise_of(self, power: Float64, position_noise: Float64) -> MissingNoise:
        """S with other powers (A, P) of the unknown forces, and noise (M,) of the readings."""
        sensors = (position_noise, self.stack.torque_noise)
        return missing_noise(self.condensed.stiffness, self.noise.reach, power, sensors)

    def answer_to(self, missing: Complex128, noise: MissingNoise) -> Complex128:
        """(A, n, k) motion of all coordinates by readings and unknown forces as they are estimated from
        missing torques (A, M, k) of covariance ``noise``."""
        solved = noise.whitener.conj().transpose(0, 2, 1) @ (noise.whitener @ missing)
        force = noise.power[..., None] * (noise.reach.conj().transpose(0, 2, 1) @ solved)
        reading = self.position_noise[:, None] * (self.condensed.stiffness.conj().transpose(0, 2, 1) @ solved)
        pushed = self.condensed.receptance @ (self.vectors @ force)
        out: Complex128 = pushed - self.condensed.motion.transpose(0, 2, 1) @ reading
        return out

    def motion_by_ends(self) -> SmoothedStack:
        """Motion by each of the ``ends`` alone, as one record for each."""
        ends, n = self.root.T, len(self.root) // 2
        pushed = ends[:, None, :n] + 1j * self.omega[:, None] * ends[:, None, n:]
        lines = -(pushed[..., None, :] @ self.condensed.receptance.transpose(0, 2, 1))[..., 0, :]
        jump, bend = _jumps(self.plant, ends * self.stack.span / 2.0)
        return replace(self, lines=lines, jump=jump, bend=bend)

    def over_time(self, vector: Float64) -> tuple[Float64, Float64]:
        """(R, k + 1) position and velocity along ``vector`` (n,).

        The parabola with the record's jumps is taken out of the lines, and put back exactly.
        """
        omega, span = self.omega, self.stack.span
        lines: Complex128 = self.lines @ vector
        jump, bend = self.jump @ vector, self.bend @ vector
        curve = parabola(omega, span, jump, bend).T
        curve[:, 0] = 0.0
        clean = np.zeros((lines.shape[0], self.grid // 2 + 1), dtype=complex)
        clean[:, : omega.size] = lines - curve
        time = np.arange(self.grid + 1) / self.grid
        ramp = jump[:, None] * (time - 0.5) + bend[:, None] * span * (time**2 / 2 - time / 2 + 1 / 12)
        slope = jump[:, None] / span + bend[:, None] * (time - 0.5)
        rate = clean * 1j * np.pad(omega, (0, clean.shape[1] - omega.size))
        where: Float64 = self.wave(clean) + ramp
        speed: Float64 = self.wave(rate) + slope
        return where, speed

    def force_over_time(self, place: int) -> Float64:
        """(R, k + 1) unknown force at a place on the grid of motion."""
        return self.wave(self.force[:, :, place])

    def wave(self, lines: Complex128) -> Float64:
        """(…, k + 1) periodic wave over time of lines (…, A)."""
        wave = np.fft.irfft(lines, self.grid) * (self.grid / 2)
        return np.concatenate((wave, wave[..., :1]), axis=-1)


def smooth(problem: Problem, value: Value) -> tuple[SmoothedStack, ...]:
    """Motion in all records at the fitted numbers."""
    return tuple(_smooth_stack(problem, value, k) for k in range(len(problem.stacks)))


def _smooth_stack(problem: Problem, value: Value, number: int) -> SmoothedStack:
    stack = problem.stacks[number]
    numbers, work = value.numbers, value.work[number]
    position_noise, torque_noise = work.position_noise, work.torque_noise
    omega = stack.records[0].wide
    condensed = numbers.plant.condense(omega)
    stiffness, motion = condensed.stiffness, condensed.motion
    wide = stack.wide
    reach = along(motion, problem.spots.vectors)
    power = colours(omega, problem.corner) @ numbers.strength.T
    noise = missing_noise(stiffness, reach, power, (position_noise, torque_noise))
    root, deviations = work.ends.root, ends_numbers(value, number)
    ends = deviations @ root.T
    n = motion.shape[2]
    named = ends[:, None, :n] + 1j * omega[:, None] * ends[:, None, n:]
    stands = wide.position
    for column, coefficient in zip(problem.columns, value.coefficients, strict=True):
        if coefficient:
            lines = column.wide(number)
            if column.reads >= 0:
                stands = stands + coefficient * lines[..., None] * np.eye(stands.shape[2])[column.reads]
            elif column.scales < 0:
                named = named + coefficient * lines[..., None] * column.vector
    missing = ((stiffness @ stands[..., None]) + (motion @ named[..., None]))[..., 0]
    missing = missing - numbers.timing.acting(wide) * torque_scales(problem, value.coefficients)
    white = (noise.whitener @ missing[..., None])[..., 0]
    solved = (noise.whitener.conj().transpose(0, 2, 1) @ white[..., None])[..., 0]
    force = power * (reach.conj().transpose(0, 2, 1) @ solved[..., None])[..., 0]
    motor = stands - position_noise * (stiffness.conj().transpose(0, 2, 1) @ solved[..., None])[..., 0]
    pushed = named - along(force, problem.spots.vectors.T)
    lines = ((motion.transpose(0, 2, 1) @ motor[..., None]) - (condensed.receptance @ pushed[..., None]))[
        ..., 0
    ]
    jump, bend = _jumps(numbers.plant, ends * stack.span / 2.0)
    sensors = (np.abs(stiffness) ** 2 * position_noise).sum(axis=2) + stack.torque_noise
    return SmoothedStack(
        stack,
        lines,
        jump,
        bend,
        deviations,
        root,
        force,
        numbers.plant,
        missing,
        sensors,
        condensed,
        noise,
        problem.spots.vectors,
        position_noise,
    )


def _jumps(plant: Plant, ends: Float64) -> tuple[Float64, Float64]:
    """(R, n) changes of position and velocity over each record, from its ends (R, 2n) in full.

    The transform of M q̈ + C q̇ + K q over a span has M(Δq̇ + jωΔq) + CΔq beside D·q: α = MΔq̇ + CΔq, β = MΔq.
    """
    _, damping, inertia = plant.matrices
    n = inertia.shape[0]
    inverse = np.linalg.inv(inertia)
    jump: Float64 = ends[:, n:] @ inverse
    bend: Float64 = (ends[:, :n] - jump @ damping) @ inverse
    return jump, bend
