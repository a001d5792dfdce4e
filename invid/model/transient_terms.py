"""Terms that the ends of a record that does not close add to its spectra.

With Δx, Δv the end-minus-start position and velocity of every coordinate,
Z_full q + (2/T)((C + jωM)Δx + MΔv) = τ: linear in 2·ΣN real numbers a record. A motor's ends also stand
between its sampled spectrum and the integral; Euler–Maclaurin: ∫f = hΣf + h/2·[f] − h²/12·[f′] with
f = x e^{−jωt}, [f] = Δx and [f′] = Δv − jωΔx.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Complex128, Float64


def motor_end_indices(structure: ChainStructure) -> npt.NDArray[np.intp]:
    """(2M,) where the motors' Δx, then their Δv, stand among the 2ΣN boundary terms."""
    motors = np.array(structure.motor_dofs)
    return np.concatenate((motors, structure.dofs + motors))


def end_forces(structure: ChainStructure, sp: Float64, omega: Float64, span: float) -> Complex128:
    """(F, ΣN, 2ΣN) force on each coordinate for a unit Δx or Δv of each, over a record of ``span`` [s]."""
    mass, damping, _ = structure.matrices(sp)
    at_position = damping + 1j * omega[:, None, None] * mass
    forces: Complex128 = np.concatenate((at_position, np.broadcast_to(mass, at_position.shape)), axis=2)
    return forces * (2.0 / span)


def end_points(omega: Float64, step: float, span: float, *, ends_in: bool) -> Complex128:
    """(F, 2) what a motor's Δx and Δv add to its sampled spectrum to make it the integral.

    ``ends_in``: whether the spectra already hold h/2·(x_n − x_0).
    """
    scale, h = 2.0 / span, step
    at_position = scale * (1j * omega * h**2 / 12)
    if not ends_in:
        at_position = at_position + scale * h / 2
    at_speed = np.full(omega.size, -scale * h**2 / 12, dtype=complex)
    return np.stack((at_position, at_speed), axis=1)


def end_columns(
    structure: ChainStructure,
    motion: Complex128,
    stiffness: Complex128,
    forces: Complex128,
    points: Complex128,
) -> Complex128:
    """(F, M, 2ΣN) missing torque for a unit Δx or Δv of each coordinate: ``forces`` through the (F, ΣN, M)
    ``motion``, and Z times the motors' end ``points``."""
    columns: Complex128 = motion.transpose(0, 2, 1) @ forces
    at_position, at_speed = motor_end_indices(structure).reshape(2, -1)
    columns[:, :, at_position] += stiffness * points[:, 0, None, None]
    columns[:, :, at_speed] += stiffness * points[:, 1, None, None]
    return columns


def end_derivative(
    structure: ChainStructure, sp: Float64, omega: Float64, motion: Complex128, ends: Float64, span: float
) -> Complex128:
    """(F, M, n) Wᵀ ∂B/∂p u: the boundary force of ``ends`` (2ΣN,) depends on mass and damping itself.

    At 0 Hz half of it, as of the force. Its pattern is that of ∂Z with −ω²q replaced by jωΔx + Δv for masses
    and couplings and jωq by Δx for dampers, so any other frequency serves where ω is zero.
    """
    shift, speed = ends[: structure.dofs], ends[structure.dofs :]
    still = omega == 0.0
    safe = np.where(still, 1.0, omega)[:, None]
    scale = np.where(still, 1.0, 2.0)[:, None] / span
    as_mass: Complex128 = (1j * omega[:, None] * shift + speed) * scale / -(safe**2)
    as_damper: Complex128 = shift * scale / (1j * safe)
    out: Complex128 = np.zeros((*motion.shape[::2], structure.count), dtype=complex)
    for q, kinds in ((as_mass, ("mass", "coupling")), (as_damper, ("damper", "viscous"))):
        full = structure.torque_derivative(sp, safe[:, 0], motion, q[None])[0]
        for kind in kinds:
            out[..., structure.slices[kind]] = full[..., structure.slices[kind]]
    return out
