"""Forward model: dynamic stiffness of the motors by the chain recursion, FRFs, resonances.

Each branch is first condensed to its two ends (motor and final mass), a recursion of N_i − 2 steps
that is vectorised over frequencies; what remains is one M×M system of the final masses per line.
The cost is F·(ΣN_i + M³) against F·(ΣN_i)³ for a full solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from invid.errors import InputError
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Complex128, Float64

# Below this ratio of a pivot to its terms the recursion has lost six of sixteen digits (the line
# lies on a resonance of a chain with both ends clamped); such lines are solved densely instead.
_PIVOT_FLOOR = 1e-6


@dataclass(frozen=True, eq=False)
class Condensed:
    """The plant seen from its motors.

    Attributes
    ----------
    omega
        (F,) angular frequency [rad/s].
    stiffness
        (F, M, M) complex dynamic stiffness Z = Wᵀ(K + jωC − ω²M)W [N·m/rad or N/m]: T = Z Θ.
    motion
        (F, ΣN, M) complex motion W of every coordinate for unit motion of each motor [−];
        rows of the motors are the identity.
    """

    omega: Float64
    stiffness: Complex128
    motion: Complex128


def condense(chains: CoupledChains, omega: npt.ArrayLike) -> Condensed:
    """Dynamic stiffness of the motors and the motion it goes with, by the chain recursion.

    Parameters
    ----------
    omega
        (F,) angular frequencies [rad/s], ≥ 0 and finite. An undamped plant has poles of Z at the
        resonances of the plant with all motors clamped; exactly there the result is not finite.
    """
    return _condense(chains, _checked(omega), with_motion=True)


def _condense(chains: CoupledChains, w: Float64, *, with_motion: bool) -> Condensed:
    lines, count = w.size, chains.branches
    w2 = w * w
    motor, ends = chains.motor_dofs, chains.end_dofs
    single = np.array([n == 1 for n in chains.masses_per_branch])

    near = np.zeros((lines, count), dtype=complex)  # A: condensed stiffness at the motor
    cross = np.zeros((lines, count), dtype=complex)  # B: motor to final mass
    end_system = (-w2[:, None, None] * chains.end_mass_matrix).astype(np.complex128)
    pivots: list[tuple[Complex128, Complex128, Complex128]] = []  # (B, κ, p) in order of elimination
    healthy = np.ones(lines, dtype=bool)
    for i in range(count):
        near[:, i] = chains.ground_springs[i] + 1j * w * chains.ground_dampers[i]
        if single[i]:
            continue
        near[:, i] -= w2 * chains.masses[i][0]
        link = chains.springs[i][:, None] + 1j * w * chains.dampers[i][:, None]
        a, b, d = link[0].copy(), -link[0], link[0]
        for q in range(1, chains.masses[i].size - 1):
            inertia = w2 * chains.masses[i][q]
            p = d + link[q] - inertia
            healthy &= np.abs(p) > _PIVOT_FLOOR * (np.abs(d) + np.abs(link[q]) + inertia)
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b_next, d = a - b * b / p, b * link[q] / p, link[q] - link[q] ** 2 / p
            pivots.append((b, link[q], p))
            b = b_next
        near[:, i] += a
        cross[:, i] = b
        end_system[:, i, i] += d

    end_motion = np.zeros((lines, count, count), dtype=complex)
    outer, inner = np.flatnonzero(single), np.flatnonzero(~single)
    end_motion[:, outer, outer] = 1.0
    every = np.arange(count)
    if inner.size == count:
        end_motion[:, every, every] = -cross
        end_motion = _solve(end_system, end_motion, healthy)
    elif inner.size:
        drive = np.zeros((lines, inner.size, count), dtype=complex)
        drive[:, :, outer] = end_system[:, inner[:, None], outer]
        drive[:, np.arange(inner.size), inner] = cross[:, inner]
        end_motion[:, inner] = -_solve(end_system[:, inner[:, None], inner], drive, healthy)
    stiffness = cross[:, :, None] * end_motion
    if outer.size:
        stiffness[:, outer] = end_system[:, outer] @ end_motion
    stiffness[:, every, every] += near

    motion = np.zeros((lines, chains.dofs if with_motion else 0, count), dtype=complex)
    if with_motion:
        motion[:, ends] = end_motion
        motion[:, motor, every] = 1.0
        _inner_motion(chains, motion, pivots)
    sick = np.flatnonzero(~healthy)
    if sick.size:
        dense_stiffness, dense_motion = _condense_densely(chains, w[sick])
        stiffness[sick] = dense_stiffness
        motion[sick] = dense_motion[:, : motion.shape[1]]
    return Condensed(w, 0.5 * (stiffness + stiffness.transpose(0, 2, 1)), motion)


def _inner_motion(
    chains: CoupledChains, motion: Complex128, pivots: list[tuple[Complex128, Complex128, Complex128]]
) -> None:
    """Back substitution x_q = (κ_q x_{q+1} − B_q θ)/p_q, from the final mass towards the motor."""
    place = 0
    for i, start in enumerate(chains.motor_dofs):
        inside = max(chains.masses[i].size - 2, 0)
        for q in range(inside, 0, -1):
            b, link, p = pivots[place + q - 1]
            with np.errstate(divide="ignore", invalid="ignore"):
                motion[:, start + q] = (link / p)[:, None] * motion[:, start + q + 1]
                motion[:, start + q, i] -= b / p
        place += inside


def _solve(matrix: Complex128, right: Complex128, healthy: npt.NDArray[np.bool_]) -> Complex128:
    """Batched solve; lines that are singular or not finite are marked, not raised."""
    if matrix.shape[1] > 1 and healthy.all():
        try:
            return np.linalg.solve(matrix, right).astype(np.complex128, copy=False)
        except np.linalg.LinAlgError:
            pass  # one line is singular: line by line below
    sound = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    healthy &= sound
    result = np.zeros_like(right)
    if matrix.shape[1] == 1:
        with np.errstate(divide="ignore", invalid="ignore"):
            result[sound] = right[sound] / matrix[sound]
        healthy &= np.isfinite(result).all(axis=(1, 2))
        return result
    try:
        result[sound] = np.linalg.solve(matrix[sound], right[sound])
    except np.linalg.LinAlgError:
        for f in np.flatnonzero(sound):
            try:
                result[f] = np.linalg.solve(matrix[f], right[f])
            except np.linalg.LinAlgError:
                healthy[f] = False
    return result


def _full_matrix(chains: CoupledChains, omega: float) -> Complex128:
    real = chains.stiffness_matrix - omega**2 * chains.mass_matrix
    return (real + 1j * omega * chains.damping_matrix).astype(np.complex128)


def _condense_densely(chains: CoupledChains, omega: Float64) -> tuple[Complex128, Complex128]:
    """Z and W of single lines by a dense, pivoted solve."""
    motor = chains.motor_dofs
    others = np.setdiff1d(np.arange(chains.dofs), motor)
    motion = np.zeros((omega.size, chains.dofs, chains.branches), dtype=complex)
    stiffness = np.zeros((omega.size, chains.branches, chains.branches), dtype=complex)
    for f, w in enumerate(omega):
        full = _full_matrix(chains, float(w))
        motion[f, motor] = np.eye(chains.branches)
        try:
            motion[f, others] = -np.linalg.solve(full[np.ix_(others, others)], full[np.ix_(others, motor)])
        except np.linalg.LinAlgError:  # exactly on an undamped pole of Z
            motion[f, others] = np.inf
        with np.errstate(invalid="ignore"):
            stiffness[f] = full[motor] @ motion[f]
    return stiffness, motion


def dynamic_stiffness(chains: CoupledChains, omega: npt.ArrayLike) -> Complex128:
    """(F, M, M) dynamic stiffness Z(jω) of the motors [N·m/rad or N/m]: T = Z Θ."""
    return _condense(chains, _checked(omega), with_motion=False).stiffness


def frf(chains: CoupledChains, omega: npt.ArrayLike) -> Complex128:
    """(F, M, M) receptance G = Z⁻¹ [rad/(N·m) or m/N]: Θ = G T.

    Raises
    ------
    InputError
        At an undamped resonance or at ω = 0 of a free plant, where G is not finite.
    """
    w = _checked(omega)
    stiffness = _condense(chains, w, with_motion=False).stiffness
    result = np.zeros_like(stiffness)
    # The inverse of Z is good wherever Z is finite and not near one of its own poles.
    sound = np.isfinite(stiffness).all(axis=(1, 2)) & (w > 0)
    if sound.any():
        condition = np.full(w.size, np.inf)
        scale = 1.0 / np.sqrt(np.abs(np.diagonal(stiffness[sound], axis1=1, axis2=2)) + np.finfo(float).tiny)
        condition[sound] = np.linalg.cond(scale[:, :, None] * stiffness[sound] * scale[:, None, :])
        sound &= condition < 1e5  # ten or more digits left
    if sound.any():
        result[sound] = np.linalg.inv(stiffness[sound])
    motor = chains.motor_dofs
    pick = np.eye(chains.dofs)[:, motor]
    for f in np.flatnonzero(~sound):
        full = _full_matrix(chains, float(w[f]))
        if not np.linalg.cond(full) < 1e15:  # no digit left
            raise InputError(
                f"FRF at ω = {w[f]:.9g} rad/s: the plant is singular there (an undamped resonance, or "
                "a rigid mode at 0); leave that line out or add damping"
            )
        result[f] = np.linalg.solve(full, pick)[motor]
    return result


def resonances(chains: CoupledChains) -> Float64:
    """(ΣN,) undamped resonances [rad/s], ascending; one exact 0 for each motor that is not grounded.

    The paper's list λ (eq. 5) is the square of this with all zeros but one removed.
    """
    natural = natural_frequencies(chains.mass_matrix, chains.stiffness_matrix)
    natural[: int(np.sum(chains.ground_springs == 0))] = 0.0
    return natural


def natural_frequencies(mass: Float64, stiffness: Float64) -> Float64:
    """(n,) undamped natural frequencies of (n, n) matrices [rad/s], ascending; 0 for rigid modes."""
    values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    natural: Float64 = np.sqrt(np.maximum(values, 0.0))
    return natural


def _checked(omega: npt.ArrayLike) -> Float64:
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    if w.ndim != 1:
        raise InputError(f"omega has shape {w.shape}; a list of angular frequencies [rad/s] is needed")
    bad = ~np.isfinite(w) | (w < 0)
    if bad.any():
        f = int(np.flatnonzero(bad)[0])
        raise InputError(f"omega[{f}] is {w[f]}; angular frequencies must be finite and ≥ 0")
    return w
