"""Equation 13: from resonances and antiresonances of one motor to its mode weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from invid.errors import InputError, NotIdentifiableError
from invid.numerics.arrays import Float64

# Distance of a resonance and an antiresonance, in roundings of the largest eigenvalue, below which the
# pair is taken as equal: what an eigenvalue solver leaves of two equal values, so exact cancellation
# only. A pair that is merely close carries weight and stays.
_EQUAL_ROUNDINGS = 30.0


def real_array(values: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """Flat float64 array, or longdouble where the caller brought extended precision (long chains
    amplify the roundings of exact lists up to 1e12 times at 8 branches of 5 masses)."""
    array = np.asarray(values).ravel()
    kind = np.longdouble if array.dtype == np.longdouble else np.float64
    return array.astype(kind)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Resonances and antiresonances of one branch that passed every check, invisible pairs removed.

    Attributes
    ----------
    poles, zeros
        (n,), (n − 1,) squared angular frequencies [rad²/s²], ascending, strictly interlaced.
    cancelled
        Squared angular frequencies of equal pairs that were removed: modes this motor cannot see.
    """

    poles: npt.NDArray[np.floating]
    zeros: npt.NDArray[np.floating]
    cancelled: Float64


def _hertz(square: float) -> str:
    return f"{np.sqrt(max(square, 0.0)) / (2 * np.pi):.4g} Hz"


def checked_spectrum(lambda_: npt.ArrayLike, lambda0: npt.ArrayLike, *, axis: str = "A1") -> Spectrum:
    """Sort, cancel equal (λ, λ0) pairs (modes the motor cannot see) and demand strict interlacing.

    Raises
    ------
    InputError
        Lists of the wrong length, not finite, negative.
    NotIdentifiableError
        Lists that do not interlace (a peak or a notch was missed), or repeated resonances.
    """
    poles, zeros = np.sort(real_array(lambda_)), np.sort(real_array(lambda0))
    for name, values in (("λ", poles), ("λ0", zeros)):
        if not np.isfinite(values).all() or np.any(values < 0):
            raise InputError(f"branch {axis}: {name} must hold finite numbers ≥ 0, found {values.tolist()}")
    if poles.size == 0 or zeros.size != poles.size - 1:
        raise InputError(
            f"branch {axis}: {poles.size} resonances (the zero included) need {poles.size - 1} "
            f"antiresonances, found {zeros.size}; both lists must come from the same frequency response"
        )
    cancelled: list[float] = []
    equal = _EQUAL_ROUNDINGS * float(np.finfo(poles.dtype).eps) * float(poles[-1])
    keep_p, keep_z = np.ones(poles.size, bool), np.ones(zeros.size, bool)
    for k, zero in enumerate(zeros):
        distance = np.where(keep_p, np.abs(poles - zero), np.inf)
        p = int(np.argmin(distance))
        if distance[p] <= equal:
            keep_p[p] = keep_z[k] = False
            cancelled.append(float(zero))
    poles, zeros = poles[keep_p], zeros[keep_z]
    for k, zero in enumerate(zeros):
        if poles[k + 1] - poles[k] <= equal:
            raise NotIdentifiableError(
                f"branch {axis}: the resonance {_hertz(poles[k])} is repeated with no antiresonance in "
                "between; equal or symmetric branches share modes: give the pair once per branch that "
                "sees it, or identify with the refined method"
            )
        if zero >= poles[k + 1]:
            raise NotIdentifiableError(
                f"branch {axis}: antiresonance {_hertz(zero)} lies above resonance "
                f"{_hertz(poles[k + 1])}; the notch between {_hertz(poles[k])} and "
                f"{_hertz(poles[k + 1])} was missed; measure longer or raise the amplitude"
            )
        if zero <= poles[k]:
            before = _hertz(zeros[k - 1]) if k else "0 Hz"
            raise NotIdentifiableError(
                f"branch {axis}: antiresonance {_hertz(zero)} lies below resonance {_hertz(poles[k])}; the "
                f"peak between {before} and {_hertz(zero)} was missed; measure longer or raise the amplitude"
            )
    return Spectrum(poles, zeros, np.array(cancelled))


def first_row_of_eigenvectors(poles: npt.ArrayLike, zeros: npt.ArrayLike) -> npt.NDArray[np.floating]:
    """(n,) first row u1 of the eigenvector matrix of B, from λ (n,) and λ0 (n − 1,), eq. 13.

    Departures from the printed form: u1 is the first *row* of the eigenvector matrix (not the first
    eigenvector), the products run over all n = ΣN_i − M + 1 retained modes (not N), and the one over
    λ omits j = i. Signs are taken positive, as the method needs squares only. Σu1² = 1 holds
    identically and therefore checks nothing; interlacing (``checked_spectrum``) is the check.
    """
    p, z = real_array(poles), real_array(zeros)
    squares = np.ones(p.size, dtype=p.dtype)
    for i in range(p.size):
        others = np.delete(p, i)
        squares[i] = np.prod((z - p[i]) / (others - p[i]))  # pairwise: no overflow for long lists
    root: npt.NDArray[np.floating] = np.sqrt(np.maximum(squares, 0.0))
    return root
