"""What the paper reads off frequency responses, read near a fitted plant: resonances, antiresonances, gains.

The motors' receptance is, to first order in damping,

    G = Σ_k ψ_k ψ_kᵀ [1/(s² + b_k s + λ_k) − 1/s²] + A_H/s²,    s = jω,

with A_H diagonal but for motors that are final masses themselves. The fitted plant says how many modes there
are and where, so none is sought: what a record misses under that plant is linear in how far λ, b, ψ and A_H
lie from it. The squares ψ_ik² over A_H of motor i are u1² of eq. 13, whose antiresonances follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy.linalg

from invid.inverse.paper import paper_inverse
from invid.model.chains import CoupledChains
from invid.model.document import parameter_vector
from invid.numerics.arrays import Complex128, Float64

STEP = 0.1
"""Standard deviations by which a reading is moved to see what the chains make of it."""


@dataclass(frozen=True, eq=False)
class PaperResult:
    """What the paper's method makes of readings.

    ``resonances`` (n,) and of each motor ``antiresonances`` (n,) [rad/s]; ``covariance`` of masses, springs
    and couplings in the order of ``names``.
    """

    chains: CoupledChains
    resonances: Float64
    antiresonances: tuple[Float64, ...]
    names: tuple[str, ...]
    covariance: Float64


@dataclass(frozen=True, eq=False)
class Readings:
    """Modes of the ``fitted`` plant as its motors show them.

    ``squares`` (n,) λ [rad²/s²], ``damping`` (n,) b [rad/s], ``shapes`` (n, M) ψ [1/√(kg·m²) or 1/√kg],
    ``high`` (M, M) A_H [1/(kg·m²) or 1/kg].
    """

    fitted: CoupledChains
    squares: Float64
    damping: Float64
    shapes: Float64
    high: Float64

    @classmethod
    def of(cls, fitted: CoupledChains) -> Readings:
        """Those of the fitted plant itself."""
        squares, modes = scipy.linalg.eigh(fitted.stiffness_matrix, fitted.mass_matrix)
        squares, modes = squares[fitted.branches :], modes[:, fitted.branches :]
        damping = np.einsum("ik,ij,jk->k", modes, fitted.damping_matrix, modes)
        motors = fitted.motor_dofs
        high = np.linalg.inv(fitted.mass_matrix)[np.ix_(motors, motors)].astype(np.float64)
        return cls(fitted, squares, damping, modes[motors].T, high)

    @cached_property
    def _high_pairs(self) -> tuple[tuple[int, int], ...]:
        single = [i for i, n in enumerate(self.fitted.masses_per_branch) if n == 1]
        return (*((i, i) for i in range(self.fitted.branches)), *combinations(single, 2))

    def moved(self, x: Float64) -> Readings:
        """The readings changed by x (p,): λ relative, b over √λ, ψ row by row, entries of A_H."""
        n, motors = self.shapes.shape
        relative, damping, shapes, entries = np.split(x, np.cumsum((n, n, n * motors)))
        high = self.high.copy()
        for (i, j), value in zip(self._high_pairs, entries, strict=True):
            high[i, j] = high[j, i] = high[i, j] + value
        return Readings(
            self.fitted,
            self.squares * (1.0 + relative),
            self.damping + damping * np.sqrt(self.squares),
            self.shapes + shapes.reshape(n, motors),
            high,
        )

    def motion_slopes(self, omega: Float64, torque: Complex128) -> Complex128:
        """(R, F, M, p) change of the motors' motion under ``torque`` (R, F, M) at ``omega`` (F,) > 0 by each
        of the changes of ``moved``."""
        n, motors = self.shapes.shape
        s = 1j * omega[:, None]
        resonant = 1.0 / (s**2 + self.damping * s + self.squares)  # (F, n)
        along = torque @ self.shapes.T  # (R, F, n)
        by_square = -(along * resonant**2 * self.squares)[:, :, None] * self.shapes.T
        by_damping = -(along * resonant**2 * s * np.sqrt(self.squares))[:, :, None] * self.shapes.T
        moved = along[..., None, :, None] * np.eye(motors)[:, None] + np.einsum(
            "rfj,ki->rfikj", torque, self.shapes
        )
        by_shape = (resonant - 1.0 / s**2)[:, None, :, None] * moved  # (R, F, M, n, M)
        by_high = np.zeros((*torque.shape, len(self._high_pairs)), dtype=complex)
        for p, (i, j) in enumerate(self._high_pairs):
            by_high[:, :, i, p], by_high[:, :, j, p] = (
                torque[:, :, j] / s[:, 0] ** 2,
                torque[:, :, i] / s[:, 0] ** 2,
            )
        parts = (by_square, by_damping, by_shape.reshape(*torque.shape, n * motors), by_high)
        return np.concatenate(parts, axis=3)

    @property
    def rigid_inverse(self) -> Float64:
        """(M, M) S⁻¹, by the sum rule A_H − Σψψᵀ."""
        out: Float64 = self.high - self.shapes.T @ self.shapes
        return out

    def antiresonances(self, motor: int) -> Float64:
        """(n,) squares λ⁰ [rad²/s²] of one motor: eigenvalues of diag(λ) where the motor stands still."""
        weight = np.concatenate(([max(self.rigid_inverse[motor, motor], 0.0) ** 0.5], self.shapes[:, motor]))
        still = scipy.linalg.null_space(weight[None])
        poles = np.concatenate(([0.0], self.squares))
        out: Float64 = np.linalg.eigvalsh(still.T @ (poles[:, None] * still))
        return out

    def chains(self) -> CoupledChains:
        """Eqs. 2–22 on the readings; dampers are those of the fitted plant.

        Raises
        ------
        NotIdentifiableError
            Readings that belong to no chain.
        """
        fitted, rigid = self.fitted, np.linalg.inv(self.rigid_inverse)
        cross = np.zeros_like(rigid)
        for i, j in combinations(range(fitted.branches), 2):  # all others held
            cross[i, j] = cross[j, i] = np.linalg.inv(rigid[np.ix_([i, j], [i, j])])[0, 1]
        poles = np.concatenate(([0.0], self.squares))
        found = paper_inverse(
            [(poles, self.antiresonances(i)) for i in range(fitted.branches)],
            np.diag(self.high),
            1.0 / np.diag(rigid),
            cross,
            fitted.masses_per_branch,
            axes=fitted.axes,
        )
        return CoupledChains.build(
            found.masses, found.springs, fitted.dampers, found.couplings, axes=fitted.axes
        )


def identify_paper(readings: Readings, x: Float64, covariance: Float64) -> PaperResult:
    """Chains by eqs. 2–22 from readings moved by ``x`` (p,) of that covariance (p, p).

    Raises
    ------
    NotIdentifiableError
        Readings that belong to no chain; says which branch and value.
    """
    at = readings.moved(x)
    found = at.chains()
    names, values = _inverse_parameters(found)
    deviation = np.sqrt(np.diag(covariance))
    slope = np.zeros((values.size, x.size))
    for k in np.flatnonzero(deviation):
        step = np.zeros(x.size)
        step[k] = STEP * deviation[k]
        slope[:, k] = (_inverse_parameters(readings.moved(x + step).chains())[1] - values) / step[k]
    return PaperResult(
        found,
        np.sqrt(at.squares),
        tuple(np.sqrt(at.antiresonances(i)) for i in range(found.branches)),
        names,
        slope @ covariance @ slope.T,
    )


def _inverse_parameters(chains: CoupledChains) -> tuple[tuple[str, ...], Float64]:
    """Masses, springs and couplings: what the paper's inverse gives."""
    names, values = parameter_vector(chains)
    given = [k for k, name in enumerate(names) if ".damper." not in name]
    return tuple(names[k] for k in given), values[given]
