"""Equations 14–16: the Lanczos recursion from the mode weights to the first rows of B."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from invid.inverse.eigenvector import real_array
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class LanczosRows:
    """First rows of the tridiagonal part of B = M^(−1/2) K M^(−1/2).

    Attributes
    ----------
    diagonal
        (s,) B11, B22, … [rad²/s²].
    off_diagonal
        (s,) B12, B23, … [rad²/s²], > 0; the last one couples into the next, unvisited coordinate.
    rows
        (s, n) u1, u2, …: rows of the eigenvector matrix.
    remainders
        (s, n) d2, d3, … before they are normalised.
    """

    diagonal: Float64
    off_diagonal: Float64
    rows: Float64
    remainders: Float64


def lanczos(poles: npt.ArrayLike, first_row: npt.ArrayLike, steps: int) -> LanczosRows:
    """``steps`` steps of Lanczos on D = diag(λ) from u1, eqs. 14–16, fully reorthogonalised.

    Departures: D is diag(λ) (in eq. 11 the letter means eig(M)); and the recursion does not end
    after one step: the Krylov space of e1…e_{N−1} stays in uncoupled coordinates, so the first N − 1
    rows of B follow from one run (the paper says that they cannot). The sign of d2 is the paper's.
    """
    d, u = real_array(poles), real_array(first_row)
    rows = [u / np.sqrt(u @ u)]
    diagonal: list[Any] = []
    off_diagonal: list[Any] = []
    remainders: list[npt.NDArray[np.floating]] = []
    for step in range(steps):
        current = rows[-1]
        alpha = current @ (d * current)  # eq. 14, first line; eq. 16
        remainder = alpha * current - d * current  # eq. 14, second line
        if step:
            remainder += off_diagonal[-1] * -rows[-2]
        for _ in range(2):  # twice is enough (Kahan)
            remainder -= np.array(rows).T @ (np.array(rows) @ remainder)
        beta = np.sqrt(remainder @ remainder)  # eq. 15
        diagonal.append(alpha)
        off_diagonal.append(beta)
        remainders.append(remainder)
        if beta <= 1e-14 * max(float(d[-1]), 1.0) and step + 1 < steps:
            break
        rows.append(remainder / beta if beta > 0 else remainder)
    return LanczosRows(
        *(
            np.array(part, dtype=np.float64)
            for part in (diagonal, off_diagonal, rows[: len(diagonal)], remainders)
        )
    )
