"""Equations 17–22: from the rows of B to the springs and masses of one branch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.inverse.lanczos import LanczosRows
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class Branch:
    """One identified branch.

    Attributes
    ----------
    masses, springs
        (N,) [kg·m² or kg], (N − 1,) [N·m/rad or N/m].
    inverse_end_mass
        (M_c⁻¹)_ii [1/(kg·m²) or 1/kg]: what the last Lanczos step says about the final masses and
        couplings, a check of them that uses no low-frequency gain; ``None`` for N = 1.
    cancelled
        Squared angular frequencies [rad²/s²] of modes this motor cannot see (removed pairs).
    """

    masses: Float64
    springs: Float64
    inverse_end_mass: float | None
    cancelled: Float64


def springs_and_masses(rows: LanczosRows, motor_mass: float, masses: int) -> tuple[Float64, Float64]:
    """All N − 1 springs and the first N − 1 masses of a branch from N − 1 rows of B, eqs. 17–19.

    K_1 = B11 m_1 (17); m_{q+1} = K_q²/(m_q B²_{q,q+1}) (19, squared and general); K_q = B_qq m_q −
    K_{q−1} (18). Departure: eq. 19 holds "regardless of N" only while mass q + 1 is uncoupled
    (q + 1 ≤ N − 1), so the last mass is left to eq. 22; for N = 2 that is every mass but the motor.
    The index sets of eqs. 20–21 are garbled in print: one call per branch yields K_i for
    i = (j−1)(N−1)+1 … j(N−1) and m_i for i = (j−1)N+1 … jN−1.
    """
    mass, stiffness = [motor_mass], [rows.diagonal[0] * motor_mass]
    for q in range(1, masses - 1):
        mass.append(stiffness[q - 1] ** 2 / (mass[q - 1] * rows.off_diagonal[q - 1] ** 2))
        stiffness.append(rows.diagonal[q] * mass[q] - stiffness[q - 1])
    return np.array(mass), np.array(stiffness)


def last_mass(branch_sum: float, others: Float64) -> float:
    """Final mass: branch sum 1/A_iL less all masses before it, eq. 22 [kg·m² or kg].

    Departure: the index is m_{Ni} = 1/A_iL − Σ_{j=N(i−1)+1}^{Ni−1} m_j, and A_iL is the gain with
    the other motors held (eq. 4).
    """
    return branch_sum - float(np.sum(others))


def inverse_end_mass(rows: LanczosRows, mass: float, stiffness: float) -> np.float64:
    """(M_c⁻¹)_ii = B²_{N−1,N} m_{N−1}/K²_{N−1} [1/(kg·m²) or 1/kg]: eq. 19 at the coupled mass."""
    return np.float64((rows.off_diagonal[-1] / np.float64(stiffness)) ** 2 * mass)


def check_positive(masses: Float64, springs: Float64, *, axis: str) -> None:
    """Raise NotIdentifiableError where a mass or spring came out ≤ 0 or not finite: the lists disagree."""
    for what, values in (("spring", springs), ("mass", masses)):
        bad = ~(np.isfinite(values) & (values > 0))
        if bad.any():
            q = int(np.flatnonzero(bad)[0])
            hint = (
                "the low-frequency gain (branch sum) does not fit the masses before it"
                if what == "mass" and q == masses.size - 1
                else "resonances, antiresonances and motor mass do not belong together"
            )
            raise NotIdentifiableError(
                f"branch {axis}: {what} {q + 1} came out at {values[q]:.6g}; {hint}; check the number of "
                "masses, measure longer or raise the amplitude"
            )


def check_numbers(motor_mass: float, branch_sum: float, masses: int, *, axis: str) -> None:
    """Raise InputError where what the user gave cannot be a branch."""
    if masses < 1:
        raise InputError(f"branch {axis}: {masses} masses; a branch has at least one")
    for what, value in (("motor mass", motor_mass), ("branch sum", branch_sum)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"branch {axis}: {what} is {value}; it must be a finite number > 0")
