"""Equations 2, 3, 7 and 8: gains at low and high frequency to masses and inertia couplings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from invid.errors import InputError
from invid.numerics.arrays import Float64


def branch_sum(low_gain: float) -> float:
    """Sum of all masses of a branch from its low-frequency acceleration gain A_iL, eq. 2 [kg·m² or kg].

    Departure: A_iL = |ω²θ_i/τ_i| for ω → 0 with every *other* motor held (eq. 4); without the hold
    the gain is (S⁻¹)_ii, off by the couplings.
    """
    return 1.0 / _positive(low_gain, "A_L")


def motor_mass(high_gain: float) -> float:
    """First mass of a branch from its high-frequency acceleration gain A_iH, eq. 3 [kg·m² or kg]."""
    return 1.0 / _positive(high_gain, "A_H")


def coupling(cross_gain: float, sum_i: float, sum_j: float) -> float:
    """Inertia coupling between the final masses of two branches, eqs. 7–8 [kg·m² or kg].

    m = −sgn(A_C)·(−1 + √(1 + 4A_C²S_iS_j))/(2|A_C|).

    Parameters
    ----------
    cross_gain
        Re(θ̈_i/τ_j) for ω → 0 with every motor but i and j held (eq. 9), *with its sign*
        [1/(kg·m²) or 1/kg].
    sum_i, sum_j
        Branch sums 1/A_iL, 1/A_jL [kg·m² or kg].

    Departures: the phase is 0 or ±π, so "sign ∠" of eq. 8 is read as sgn Re(θ̈_i/τ_j); the other root
    and the case m² > S_iS_j cannot occur, as the mass matrix is positive definite. The paper's figures
    plot +ω²θ/τ, which has the opposite sign.
    """
    if not np.isfinite(cross_gain):
        raise InputError(f"cross gain A_C is {cross_gain}; it must be a finite number")
    product = _positive(sum_i, "branch sum") * _positive(sum_j, "branch sum")
    gain = abs(cross_gain)
    # (−1 + √(1+x))/(2A) written without the cancellation at small A
    return float(-np.sign(cross_gain) * 2.0 * gain * product / (1.0 + np.sqrt(1.0 + 4.0 * gain**2 * product)))


def couplings(cross_gains: npt.ArrayLike, sums: npt.ArrayLike) -> Float64:
    """(M, M) couplings from signed cross gains (M, M) (either triangle or both) and branch sums (M,)."""
    gains, total = np.asarray(cross_gains, dtype=float), np.asarray(sums, dtype=float)
    result = np.zeros((total.size, total.size))
    if gains.shape != result.shape:
        raise InputError(f"cross gains have shape {gains.shape}; {result.shape} is needed")
    for i in range(total.size):
        for j in range(i + 1, total.size):
            both = [g for g in (gains[i, j], gains[j, i]) if g != 0]
            result[i, j] = result[j, i] = coupling(float(np.mean(both)) if both else 0.0, total[i], total[j])
    return result


def _positive(value: float, name: str) -> float:
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} is {value}; it must be a finite number > 0")
    return float(value)
