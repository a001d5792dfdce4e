"""Equation 23: the first mass and spring of a branch taken away, on responses and on lists."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from invid.numerics.arrays import Complex128, Float64


def peel_response(omega: npt.ArrayLike, response: npt.ArrayLike, mass: float, spring: float) -> Complex128:
    """(F,) receptance of one branch seen from its second mass, eq. 23.

    τ2 = τ1 + ω² m1 θ1 and θ2 = θ1 − τ2/K1. Departure: the paper prints τ1/K1, which is 78 % wrong on
    its own case study, because the spring carries τ2 = K1(θ1 − θ2).
    """
    w, g = np.asarray(omega, dtype=float), np.asarray(response, dtype=complex)
    torque = 1.0 + mass * w**2 * g
    peeled: Complex128 = (g - torque / spring) / torque
    return peeled


def peel_all(
    omega: npt.ArrayLike,
    motion: npt.ArrayLike,
    torque: npt.ArrayLike,
    masses: npt.ArrayLike,
    springs: npt.ArrayLike,
    dampers: npt.ArrayLike | None = None,
) -> tuple[Complex128, Complex128]:
    """First mass and spring of all branches at once: T2 = T + ω²mΘ, Θ2 = Θ − K⁻¹T2 (eq. 23, matrix).

    Departure: after peeling one branch alone its resonances are those of the plant without *its*
    (m1, K1) and no longer common to all branches; common ones need the full matrix, as here.

    Parameters
    ----------
    motion, torque
        (F, M, E) motions [rad or m] and torques [N·m or N] of E load cases (E = M, torque = I for a
        receptance matrix).
    masses, springs, dampers
        (M,) values of the first mass, spring (and damper beside it) of every branch.
    """
    w = np.asarray(omega, dtype=float)[:, None, None]
    theta, tau = np.asarray(motion, dtype=complex), np.asarray(torque, dtype=complex)
    m = np.asarray(masses, dtype=float)[None, :, None]
    link = np.asarray(springs, dtype=float)[None, :, None] + 0j
    if dampers is not None:
        link = link + 1j * w * np.asarray(dampers, dtype=float)[None, :, None]
    tau2: Complex128 = tau + w**2 * m * theta
    theta2: Complex128 = theta - tau2 / link
    return theta2, tau2


def peel_spectrum(poles: npt.ArrayLike, first_row: npt.ArrayLike) -> tuple[Float64, Float64]:
    """λ (n − 1,) and λ0 (n − 2,) of the branch once its first mass and spring are taken away.

    The lists that eq. 23 leads to, without evaluating a response: the new resonances solve
    τ2 = Σu1²λ/(λ − ω²) = 0 (plus the rigid 0), the new antiresonances are those with the first two
    masses locked. Both are eigenvalues of D = diag(λ) on a subspace, hence real by construction.
    They are poles of the peeled branch only: no longer common to all branches.
    """
    d, u = np.asarray(poles, dtype=float), np.asarray(first_row, dtype=float)
    moving = d > 0
    rigid = np.zeros(1 if not moving.all() else 0)
    inner = _restricted(d[moving], (np.sqrt(d[moving]) * u[moving])[:, None])
    new_poles = np.sort(np.concatenate((rigid, inner)))
    second = d * u - (u @ (d * u)) * u
    new_zeros = _restricted(d, np.column_stack((u, second)))
    return new_poles, new_zeros


def _restricted(diagonal: Float64, forbidden: Float64) -> Float64:
    """Eigenvalues of diag(diagonal) on the orthogonal complement of the columns ``forbidden``."""
    size, taken = forbidden.shape
    if size <= taken:
        return np.zeros(0)
    basis = scipy.linalg.qr(forbidden / np.linalg.norm(forbidden, axis=0), mode="full")[0][:, taken:]
    values: Float64 = np.linalg.eigvalsh(basis.T @ (diagonal[:, None] * basis))
    return np.maximum(values, 0.0)
