"""The modal model of coupled chains with free motors, and what follows from it.

G(ω) = Σ_r {φ_r φ_rᵀ [1/D_r + 1/ω²] + j(ω/ω_r)(φ_r χ_rᵀ + χ_r φ_rᵀ)/D_r} − A_H/ω² − jB/ω³,
D_r = ω_r² − ω² + 2jζ_rω_rω,

with one pair of poles for each spring. The bracket carries the sum rule S⁻¹ = A_H − Σ φ_r φ_rᵀ, which
ties the low-frequency gains to the modes; A_H is diagonal but for motors that are final masses
themselves (N_i = 1). χ takes dampers that are not proportional to the springs (complex modes), B the
motors' viscous friction, both to first order: what is left in ω_r and φ_r is the undamped plant to
second order in damping.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy

from invid.numerics.arrays import Bool, Complex128, Float64


def pairs(count: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Row and column of the P = M(M+1)/2 entries of a symmetric matrix, row after row."""
    return np.triu_indices(count)


def high_gain_pairs(masses: tuple[int, ...]) -> Bool:
    """(P,) True where A_H has an entry: the diagonal, and between two single-mass branches."""
    rows, columns = pairs(len(masses))
    single = np.array(masses) == 1
    allowed: Bool = (rows == columns) | (single[rows] & single[columns])
    return allowed


@dataclass(frozen=True, eq=False)
class Modes:
    """Fitted modes of the plant seen from its motors.

    Attributes
    ----------
    omega, damping
        (n,) resonances [rad/s], ascending, and damping ratios [−]; n = Σ(N_i − 1).
    shapes
        (n, M) mass-normalised motions φ_r of the motors [1/√(kg·m²) or 1/√kg].
    high_gain
        (M, M) A_H: acceleration gain above all modes [1/(kg·m²) or 1/kg].
    friction
        (M, M) B: first-order trace of motor friction [1/(kg·m²·s) or 1/(kg·s)].
    masses
        (M,) masses per branch the fit was made for.
    covariance
        Joint covariance of [log ω, log ζ, φ row by row, A_H entries, B entries, χ row by row].
    lag
        (n, M) χ; zero where the data do not ask for complex modes.
    model_error
        Relative FRF error that had to be added to the noise for χ²/dof = 1; 0 where noise suffices.
    """

    omega: Float64
    damping: Float64
    shapes: Float64
    high_gain: Float64
    friction: Float64
    masses: tuple[int, ...]
    covariance: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    model_error: float = 0.0
    lag: Float64 = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def rigid_inverse(self) -> Float64:
        """(M, M) S⁻¹ by the sum rule A_H − Σ φφᵀ."""
        inverse: Float64 = self.high_gain - self.shapes.T @ self.shapes
        return inverse

    def weights(self, axis: int) -> tuple[Float64, Float64]:
        """λ (n + 1,) with the rigid 0 first, and the weights of the modes in (G_ii) [λ; 1/mass]."""
        poles = np.concatenate(([0.0], self.omega**2))
        return poles, np.concatenate(([self.rigid_inverse[axis, axis]], self.shapes[:, axis] ** 2))

    def zeros(self, axis: int) -> tuple[Float64, Float64]:
        """Antiresonances of branch ``axis`` and their standard deviations [rad/s], (n,) each.

        Roots of Σ w_k/(λ_k − a) = 0: eigenvalues of diag(λ) on the complement of √w. The deviations
        follow from the joint covariance, so that the correlation of close pairs counts.
        """
        poles, weight = self.weights(axis)
        root = np.sqrt(np.maximum(weight, 0.0))
        if root.size < 2 or not root.any():
            return np.zeros(0), np.zeros(0)
        basis = scipy.linalg.qr(root[:, None] / np.linalg.norm(root), mode="full")[0][:, 1:]
        squares = np.maximum(np.linalg.eigvalsh(basis.T @ (poles[:, None] * basis)), 0.0)
        omega = np.sqrt(squares)
        return omega, self._zero_std(axis, squares, poles, weight)

    def _zero_std(self, axis: int, squares: Float64, poles: Float64, weight: Float64) -> Float64:
        n, count = self.shapes.shape
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / (poles[None, :] - squares[:, None])
            slope = np.sum(weight * inverse**2, axis=1)
            by_weight, by_pole = -inverse, weight * inverse**2
            jacobian = np.zeros((squares.size, self.covariance.shape[0]))
            jacobian[:, :n] = by_pole[:, 1:] * 2 * self.omega**2
            phi = self.shapes[:, axis]
            jacobian[:, 2 * n + np.arange(n) * count + axis] = (by_weight[:, 1:] - by_weight[:, :1]) * 2 * phi
            allowed = np.flatnonzero(high_gain_pairs(self.masses))
            rows, columns = pairs(count)
            place = int(np.flatnonzero((rows[allowed] == axis) & (columns[allowed] == axis))[0])
            jacobian[:, 2 * n + n * count + place] = by_weight[:, 0]
            jacobian /= slope[:, None]
            variance = np.einsum("ij,jk,ik->i", jacobian, self.covariance, jacobian)
            std: Float64 = np.sqrt(np.maximum(variance, 0.0)) / (2 * np.sqrt(squares))
        return np.asarray(np.where(np.isfinite(std), std, np.inf), dtype=np.float64)

    def response(self, omega: npt.ArrayLike) -> Complex128:
        """(F, M, M) fitted receptance."""
        w = np.asarray(omega, dtype=float)
        shape = mode_shape_functions(w, self.omega, self.damping)
        product = np.einsum("ri,rj->rij", self.shapes, self.shapes)
        response: Complex128 = (
            np.einsum("fr,rij->fij", shape, product).astype(np.complex128)
            - self.high_gain / w[:, None, None] ** 2
            - 1j * self.friction / w[:, None, None] ** 3
        )
        if self.lag.size:
            turned = np.einsum("ri,rj->rij", self.shapes, self.lag)
            quarter = lag_functions(w, self.omega, self.damping)
            response += np.einsum("fr,rij->fij", quarter, turned + turned.transpose(0, 2, 1))
        return response


def mode_shape_functions(w: Float64, omega: Float64, damping: Float64) -> Complex128:
    """(F, n) b_r(ω) = 1/(ω_r² − ω² + 2jζ_rω_rω) + 1/ω²."""
    w2 = (w * w)[:, None]
    values = 1.0 / (omega**2 - w2 + 2j * damping * omega * w[:, None]) + 1.0 / w2
    return values.astype(np.complex128)


def lag_functions(w: Float64, omega: Float64, damping: Float64) -> Complex128:
    """(F, n) j(ω/ω_r)/D_r(ω), the shape of χ."""
    w2 = (w * w)[:, None]
    ratio = 1j * w[:, None] / omega
    values = ratio / (omega**2 - w2 + 2j * damping * omega * w[:, None])
    return values.astype(np.complex128)
