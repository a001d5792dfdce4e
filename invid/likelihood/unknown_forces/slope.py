"""The exact gradient of −2 ln L by all numbers and strengths, and its curvature; no parameter has code of its
own.

With dD = u uᵀ the missing torque moves by V u (uᵀq), q the motion of every coordinate that measured motion,
laws and ends ask for, and S through dZ = V u uᵀVᵀ and dH = −V u uᵀX b; with a strength q_p S moves by
g H_p H_pᴴ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.forces import COLOURS, colours
from invid.likelihood.unknown_forces.timing import Timing
from invid.likelihood.unknown_forces.value import (
    NEARLY_SINGULAR,
    Problem,
    StackWork,
    Value,
    along,
    closed_loop,
    reading_stretch,
    real_rows,
    swings,
    torque_scales,
)
from invid.numerics.arrays import Complex128, Float64, Int64


@dataclass(frozen=True, eq=False)
class Slope:
    """Half the gradient (p,) of −2 ln L by the numbers, and its curvature (p, p) with the laws profiled out.

    For a step s the value falls by −2·gradient·s − sᵀ·curvature·s. ``joint`` (p + J', p + J') is the
    curvature with the J' free coefficients beside the numbers. ``pull`` (P, 2) is half the gradient by the
    strengths, and ``whole`` (p + k, p + k) Fisher's information on the numbers and the k strengths ``moving``
    (indices in P × 2), what S tells of both included.
    """

    gradient: Float64
    curvature: Float64
    joint: Float64
    pull: Float64
    whole: Float64
    moving: Int64


def slope(problem: Problem, value: Value) -> Slope:
    """The exact gradient of −2 ln L, and Gauss and Newton's curvature of its sum of squares."""
    numbers = value.numbers
    terms = numbers.plant.structure.terms
    plant, size = numbers.plant.x.size, numbers.x.size
    free = np.flatnonzero(value.free)
    joint = np.zeros((size + free.size, size + free.size))
    gradient, pull = np.zeros(size), np.zeros(numbers.strength.shape)
    for k, work in enumerate(value.work):
        rows = work.missing + work.laws @ value.coefficients
        factor = terms.factors(work.stack.omega, numbers.plant.slope)
        seen = along(work.condensed.motion, terms.vectors)
        columns = number_rows(problem, value, k)
        flat = np.concatenate((columns, work.laws[..., free]), axis=2).reshape(-1, joint.shape[0])
        joint += flat.T @ flat
        gradient += columns.reshape(-1, size).T @ rows.ravel()
        left = _Left.of(work, rows)
        gradient[:plant] += terms.by_parameter(_covariance_slope(problem, value, work, left, seen, factor))
        gradient[:plant] += terms.by_parameter(_prior_slope(problem, value, work, left.by_root))
        pull += _strength_slope(problem, work, left)
    prior = 1.0 / problem.spread**2
    gradient += (numbers.x - problem.centre) * prior
    gradient -= _through_laws(problem, value, joint, size)
    joint[np.arange(size), np.arange(size)] += prior
    curvature = _profiled(joint, size)
    moving = np.flatnonzero((pull < 0.0) | (numbers.strength > problem.least))
    moving = moving[~np.isin(moving // COLOURS, problem.shut)]
    whole = np.zeros((size + moving.size, size + moving.size))
    whole[:size, :size] = curvature
    for work in value.work:
        told = _covariance_columns(problem, value, work, moving)
        at = np.concatenate((np.arange(plant), size + np.arange(moving.size)))
        whole[np.ix_(at, at)] += told.T @ told
    return Slope(gradient, curvature, joint, pull, whole, moving)


def number_rows(problem: Problem, value: Value, number: int) -> Float64:
    """(R, 2FM, p) whitened derivative of a stack's missing torque by the numbers, without the ends' share."""
    work, plant = value.work[number], value.numbers.plant
    terms = plant.structure.terms
    seen = work.whitener @ along(work.condensed.motion, terms.vectors)
    moved = along(inner_motion(problem, value, number), terms.vectors)
    moved = moved * terms.factors(work.stack.omega, plant.slope)
    by_plant = terms.by_parameter(seen[None] * moved[:, :, None])
    scales = torque_scales(problem, value.coefficients)
    by_timing = _timing_columns(work, value.numbers.timing, scales)
    rows = np.concatenate((real_rows(by_plant), real_rows(by_timing)), axis=2)
    return work.ends.out_of(rows)


def whitened_rows(work: StackWork, lines: Complex128) -> Float64:
    """(R, 2FM, k) whitened rows of torques at the motors (R, F, M, k), without the ends' share."""
    rows = real_rows(work.whitener @ lines)
    return work.ends.out_of(rows)


def _through_laws(problem: Problem, value: Value, joint: Float64, size: int) -> Float64:
    """(p,) half the gradient through laws in the loop (friction, scales), whose coefficients follow the
    numbers."""
    free = np.flatnonzero(value.free)
    pull = np.zeros(free.size)
    scales = torque_scales(problem, value.coefficients)
    for work in value.work:
        stack = work.stack
        loop = closed_loop(problem, work, value.coefficients)
        inverse = np.linalg.inv(loop)
        answer = np.einsum("rfii->rfi", inverse) * work.turning[:, None]
        turned = np.einsum("rfij,fji->rfi", inverse, work.condensed.stiffness) * work.turning[:, None]
        stretched = -2.0 * turned.real.sum(axis=(0, 1))
        damped = -2.0 * (answer * 1j * stack.omega[:, None]).real.sum(axis=(0, 1))
        scaled = -2.0 * (answer * stack.loop[stack.closed]).real.sum(axis=(0, 1))
        scaled = scaled - 2.0 * float(work.turning.sum() * (~stack.closed).sum()) / scales
        for k, j in enumerate(free):
            column = problem.columns[j]
            pull[k] += damped[column.damps] if column.damps >= 0 else 0.0
            pull[k] += scaled[column.scales] if column.scales >= 0 else 0.0
            pull[k] += column.stretch * stretched[column.reads] if column.reads >= 0 else 0.0
    if not pull.any():
        return np.zeros(size)
    out: Float64 = joint[:size, size:] @ solve_scaled(joint[size:, size:], pull)
    return out


def solve_scaled(matrix: Float64, right: Float64) -> Float64:
    """Solution of a positive system whose unknowns have units of their own."""
    unit = np.sqrt(np.diag(matrix)) + 1e-300
    scaled = matrix / unit[:, None] / unit + NEARLY_SINGULAR * np.eye(unit.size)
    out: Float64 = (np.linalg.solve(scaled, (right.T / unit).T).T / unit).T
    return out


def _profiled(joint: Float64, size: int) -> Float64:
    """Curvature of the first ``size`` numbers with the rest at its best for each."""
    if joint.shape[0] == size:
        return joint
    cross = joint[:size, size:]
    out: Float64 = joint[:size, :size] - cross @ solve_scaled(joint[size:, size:], cross.T)
    return out


def ends_numbers(value: Value, number: int) -> Float64:
    """(R, 2n) the ends of each record of a stack, in deviations."""
    out: Float64 = value.work[number].law_ends @ np.append(value.coefficients, 1.0)
    return out


def ends_of(value: Value, number: int) -> Float64:
    """(R, 2n) the ends α, then β_e, of each record of a stack, over 2/T."""
    return np.asarray(ends_numbers(value, number) @ value.work[number].ends.root.T)


def named_force(problem: Problem, value: Value, number: int) -> Complex128:
    """(R, F, n) force of laws and ends on every coordinate."""
    work = value.work[number]
    n = problem.spots.vectors.shape[0]
    ends = ends_of(value, number)
    omega = work.stack.omega
    force = ends[:, None, :n] + 1j * omega[:, None] * ends[:, None, n:]
    for column, coefficient in zip(problem.columns, value.coefficients, strict=True):
        if coefficient and column.reads < 0 and column.scales < 0:
            force = force + coefficient * column.lines[number][..., None] * column.vector
    return force


def standing(problem: Problem, value: Value, reading: Complex128, lines: Sequence[Complex128]) -> Complex128:
    """(R, F, M) where the motors stand by their reading and the laws of it, of ``lines`` (R, F)."""
    out = reading
    for column, coefficient, wave in zip(problem.columns, value.coefficients, lines, strict=True):
        if coefficient and column.reads >= 0:
            out = out + coefficient * wave[..., None] * np.eye(reading.shape[2])[column.reads]
    return out


def inner_motion(problem: Problem, value: Value, number: int) -> Complex128:
    """(R, F, n) motion of every coordinate that measured motor motion, laws and ends ask for: Vᵀθ −
    X·force."""
    work = value.work[number]
    motion, receptance = work.condensed.motion, work.condensed.receptance
    stands = standing(problem, value, work.stack.position, [c.lines[number] for c in problem.columns])
    moved = (motion.transpose(0, 2, 1) @ stands[..., None])[..., 0]
    out: Complex128 = moved - (receptance @ named_force(problem, value, number)[..., None])[..., 0]
    return out


def _timing_columns(work: StackWork, timing: Timing, scales: Float64) -> Complex128:
    """(R, F, M, 5M) whitened −dτ by the timing's numbers: of axis m at motor m alone."""
    slopes = timing.slopes(work.stack) * scales[:, None]
    columns = -work.whitener[None, :, :, None, :] * slopes.transpose(0, 1, 3, 2)[:, :, None]
    return columns.reshape(*slopes.shape[:3], slopes.shape[2] * slopes.shape[3])


@dataclass(frozen=True, eq=False)
class _Left:
    """What is left of a stack's rows: ``balance`` (F, M, M) half the gradient by S, weights included,
    ``by_ends`` (F, 2n, M) that by the ends' reach and ``by_root`` (2n, 2n) that by the root of their prior.

    With E the covariance that is left of the ends of J, S⁻¹R − Σ S⁻¹r rᴴS⁻¹ − R·S⁻¹J E JᴴS⁻¹, and R·E JᴴS⁻¹.
    """

    balance: Complex128
    by_ends: Complex128
    by_root: Float64

    @classmethod
    def of(cls, work: StackWork, rows: Float64) -> _Left:
        """Of missing torque with the laws in it (R, 2FM)."""
        left = work.left(rows)
        turned, double = work.whitener.conj().transpose(0, 2, 1), (2.0 * work.stack.weight)[:, None, None]
        pulled = turned @ work.on_lines(left).transpose(1, 2, 0)
        told = (pulled @ pulled.conj().transpose(0, 2, 1)) / double
        jumps = turned @ (work.whitener @ work.condensed.jumps(work.stack.omega))
        by_ends = work.stack.count * (work.ends.covariance @ jumps.conj().transpose(0, 2, 1))
        balance = work.stack.count * (turned @ work.whitener) - told - jumps @ by_ends / double
        return cls(balance, by_ends, work.ends.steepness(rows, left))


def _prior_slope(problem: Problem, value: Value, work: StackWork, steep: Float64) -> Float64:
    """(T,) half the gradient by each term through the root of the ends' prior, which has M and C in it."""
    terms = value.numbers.plant.structure.terms
    size = work.condensed.receptance.shape[-1]
    fast, far = swings(problem, work.stack, reading_stretch(problem, value.coefficients))
    by_mass = fast * steep[:size, :size] + far * steep[size:, size:]
    by_damper = far * steep[:size, size:]
    one, two = terms.factors(np.array([1.0, 2.0]), value.numbers.plant.slope)  # −ω², jω and 1
    mass, damping = ((terms.vectors * (part @ terms.vectors)).sum(axis=0) for part in (by_mass, by_damper))
    out: Float64 = mass * (one - two).real / 3.0 + damping * one.imag
    return out


def _strength_slope(problem: Problem, work: StackWork, left: _Left) -> Float64:
    """(P, 2) half the gradient by each strength, in the quadratic form and in ln|S|."""
    reach = work.noise.reach
    pull = (reach.conj() * (left.balance @ reach)).real.sum(axis=1) / 2.0
    out: Float64 = pull.T @ colours(work.stack.omega, problem.corner)
    return out


def _covariance_columns(problem: Problem, value: Value, work: StackWork, moving: Int64) -> Float64:
    """(2FM², P' + k) W·dS·Wᴴ by the plant's numbers and by the strengths ``moving``, so weighed that products
    of columns are Fisher's information of S, halved as the curvature is."""
    plant = value.numbers.plant
    terms, condensed, noise = plant.structure.terms, work.condensed, work.noise
    lines, motors = work.shape[1:]
    weight = np.sqrt(work.stack.count * work.stack.weight)[:, None, None]
    whitener = noise.whitener * weight**0.5
    seen = along(condensed.motion, terms.vectors)
    # uᵀ(VᵀC_θZᴴ − X b q g Hᴴ): what one side of S gains by a change u uᵀ of D
    turned = condensed.stiffness.conj().transpose(0, 2, 1)
    pushed = problem.spots.vectors @ (noise.power[:, :, None] * noise.reach.conj().transpose(0, 2, 1))
    inner = condensed.motion.transpose(0, 2, 1) @ (work.position_noise[:, None] * turned)
    gains = terms.vectors.T @ (inner - condensed.receptance @ pushed)
    left = (whitener @ seen) * terms.factors(work.stack.omega, plant.slope)[:, None]
    right = gains @ whitener.conj().transpose(0, 2, 1)
    half = terms.by_parameter(left[:, :, None] * right.transpose(0, 2, 1)[:, None])
    by_plant = half + half.conj().transpose(0, 2, 1, 3)
    reach = (whitener @ noise.reach)[:, :, moving // COLOURS]
    power = colours(work.stack.omega, problem.corner)[:, moving % COLOURS]
    by_strength = reach[:, :, None] * reach.conj()[:, None] * power[:, None, None]
    both = np.concatenate((by_plant, by_strength), axis=3).reshape(lines * motors**2, -1)
    return np.concatenate((both.real, both.imag))


def _covariance_slope(
    problem: Problem, value: Value, work: StackWork, left: _Left, seen: Complex128, factor: Complex128
) -> Float64:
    """(T,) half the gradient by each term through S, in the quadratic form and in ln|S|, and through the
    loop.

    With G the balance half the change is Re tr(G·dZ C_θ Zᴴ) + Re tr(G·dH q g Hᴴ), dZ = V u uᵀ Vᵀ,
    dH = −V u uᵀX b, and through the ends Re tr(E JᴴS⁻¹·dJ), dJ = −V u uᵀX·(1, jω).
    """
    terms = value.numbers.plant.structure.terms
    noise, condensed = work.noise, work.condensed
    pull = left.balance @ seen
    motion_noise = work.position_noise[:, None] * condensed.stiffness.conj().transpose(0, 2, 1)
    by_motion = (seen * (motion_noise @ pull)).sum(axis=1)
    pushed = (noise.power[:, :, None] * noise.reach.conj().transpose(0, 2, 1)).transpose(0, 2, 1)  # (F, M, P)
    pushed = along(pushed, problem.spots.vectors.T).transpose(0, 2, 1)  # (F, n, M)
    by_force = -(along(condensed.receptance, terms.vectors) * (pushed @ pull)).sum(axis=1)
    size = condensed.receptance.shape[-1]
    swung = left.by_ends[:, :size] + 1j * work.stack.omega[:, None, None] * left.by_ends[:, size:]
    by_ends = -(along(condensed.receptance, terms.vectors) * (swung @ seen)).sum(axis=1)
    out = ((by_motion + by_force + by_ends) * factor).real
    loop = closed_loop(problem, work, value.coefficients)
    if loop.size:
        answer = np.linalg.inv(loop).sum(axis=0)
        stretch = reading_stretch(problem, value.coefficients)[:, None]
        closed = (seen * stretch * (answer @ seen)).sum(axis=1) * factor
        out = out - 2.0 * work.turning[:, None] * closed.real
    total: Float64 = out.sum(axis=0)
    return total
