"""The paper's inverse as a whole: lists and gains of every branch to the coupled chains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from invid.errors import InputError, NotIdentifiableError
from invid.inverse.coupling import branch_sum, couplings, motor_mass
from invid.inverse.eigenvector import checked_spectrum, first_row_of_eigenvectors
from invid.inverse.lanczos import lanczos
from invid.inverse.springs import (
    Branch,
    check_numbers,
    check_positive,
    inverse_end_mass,
    last_mass,
    springs_and_masses,
)
from invid.model.chains import CoupledChains


def chain_from_spectrum(
    lambda_: npt.ArrayLike,
    lambda0: npt.ArrayLike,
    m1: float,
    branch_sum: float,
    masses: int,
    *,
    axis: str = "A1",
) -> Branch:
    """One branch from its squared resonances and antiresonances, motor mass and branch sum.

    N − 1 steps of eqs. 14–16 in one run: no peeling is needed, whatever the paper says.

    Parameters
    ----------
    lambda_, lambda0
        (n,) and (n − 1,) squared angular frequencies [rad²/s²] from *one* frequency response, rigid
        zeros of the other branches removed from both. Pairs that are equal are cancelled first.
    m1
        Motor mass, from eq. 3 or the datasheet [kg·m² or kg]; not used for ``masses`` = 1.
    branch_sum
        Sum of the branch's masses, eq. 2 [kg·m² or kg].

    Raises
    ------
    InputError, NotIdentifiableError
        Say which list is wrong, or why the branch cannot be found.
    """
    check_numbers(m1, branch_sum, masses, axis=axis)
    spectrum = checked_spectrum(lambda_, lambda0, axis=axis)
    if masses == 1:
        return Branch(np.array([branch_sum]), np.zeros(0), None, spectrum.cancelled)
    if spectrum.poles.size < masses:
        seen = f" ({spectrum.cancelled.size} more are invisible to it)" if spectrum.cancelled.size else ""
        raise NotIdentifiableError(
            f"branch {axis}: {masses} masses need at least {masses} resonances, the zero included, and "
            f"this motor sees {spectrum.poles.size}{seen}; use fewer masses or a wider band"
        )
    rows = lanczos(spectrum.poles, first_row_of_eigenvectors(spectrum.poles, spectrum.zeros), masses - 1)
    m, k = springs_and_masses(rows, m1, masses)
    check = inverse_end_mass(rows, m[-1], k[-1])
    m = np.append(m, last_mass(branch_sum, m))
    check_positive(m, k, axis=axis)
    return Branch(m, k, check, spectrum.cancelled)


def paper_inverse(
    spectra: Sequence[tuple[npt.ArrayLike, npt.ArrayLike]],
    high_gains: npt.ArrayLike,
    low_gains: npt.ArrayLike,
    cross_gains: npt.ArrayLike,
    masses: Sequence[int],
    *,
    axes: Sequence[str] | None = None,
) -> CoupledChains:
    """All parameters of the coupled chains from what the paper measures (sections 3.1 to 3.4).

    Parameters
    ----------
    spectra
        Per branch (λ, λ0) [rad²/s²].
    high_gains, low_gains
        (M,) A_iH (eq. 3) and A_iL with the other motors held (eq. 2) [1/(kg·m²) or 1/kg].
    cross_gains
        (M, M) signed A_C = Re(θ̈_i/τ_j) at low frequency, all but i and j held (eqs. 7–9).
    masses
        (M,) number of masses per branch.
    """
    high, low = np.asarray(high_gains, dtype=float), np.asarray(low_gains, dtype=float)
    count = len(spectra)
    names = list(axes) if axes is not None else [f"A{i + 1}" for i in range(count)]
    if not (count == high.size == low.size == len(masses) == len(names)):
        raise InputError(
            f"paper inverse: {count} pairs of lists, {high.size} A_H, {low.size} A_L, {len(masses)} mass "
            f"counts and {len(names)} axes; all must be as many as there are branches"
        )
    sums = np.array([branch_sum(float(a)) for a in low])
    branches = [
        chain_from_spectrum(p, z, motor_mass(float(high[i])), sums[i], masses[i], axis=names[i])
        for i, (p, z) in enumerate(spectra)
    ]
    return CoupledChains.build(
        [b.masses for b in branches],
        [b.springs for b in branches],
        couplings=couplings(cross_gains, sums),
        axes=names,
    )
