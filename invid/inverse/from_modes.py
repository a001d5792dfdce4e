"""From fitted modes to the coupled chains: the paper's inverse on measured data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from invid.errors import ModelError, NotIdentifiableError
from invid.inverse.lanczos import lanczos
from invid.inverse.springs import check_positive, last_mass, springs_and_masses
from invid.model.chains import CoupledChains
from invid.model.document import parameter_vector
from invid.modes.model import Modes, high_gain_pairs, pairs
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class Gains:
    """The asymptotes the paper reads off, here from the fitted modes.

    Attributes
    ----------
    high
        (M,) A_iH [1/(kg·m²) or 1/kg].
    rigid_mass
        (M, M) S: branch sums 1/A_iL (others held) on the diagonal, couplings beside it [kg·m² or kg].
    """

    high: Float64
    rigid_mass: Float64


def gains_of(modes: Modes, *, axes: tuple[str, ...]) -> Gains:
    """High-frequency gains and the rigid mass matrix; NotIdentifiableError where no mass fits them."""
    high = np.diag(modes.high_gain).copy()
    if np.any(high <= 0):
        i = int(np.argmin(high))
        raise NotIdentifiableError(
            f"branch {axes[i]}: the acceleration gain above all modes came out at {high[i]:.4g}, no motor "
            "mass fits that; measure further above the last resonance or use fewer masses"
        )
    inverse = modes.rigid_inverse
    if float(np.linalg.eigvalsh(inverse / np.sqrt(np.outer(high, high)))[0]) <= 1e-9:
        raise NotIdentifiableError(
            "the low-frequency gains came out with no positive definite mass matrix; measure longer at low "
            "frequency, raise the amplitude (friction), or use fewer masses"
        )
    return Gains(high.astype(np.float64), np.linalg.inv(inverse).astype(np.float64))


def chains_of(modes: Modes, gains: Gains, *, axes: tuple[str, ...], dampers: bool = True) -> CoupledChains:
    """Coupled chains from modes and gains, eqs. 13–22 on the weights of the fitted modes.

    The weights φ_ir²/A_iH *are* u1² of eq. 13 (its products over λ and λ0 return them), so the
    recursion starts from them; the antiresonances stay a result for people (``Modes.zeros``).

    Raises
    ------
    NotIdentifiableError
        Where that is no physical chain: says which branch and value.
    """
    masses, springs = [], []
    for i, count in enumerate(modes.masses):
        total = float(gains.rigid_mass[i, i])
        if count == 1:
            masses.append(np.array([total]))
            springs.append(np.zeros(0))
            continue
        poles = np.concatenate(([0.0], modes.omega**2))
        weight = np.concatenate(([np.linalg.inv(gains.rigid_mass)[i, i]], modes.shapes[:, i] ** 2))
        rows = lanczos(poles, np.sqrt(np.maximum(weight, 0.0)), count - 1)
        if rows.diagonal.size < count - 1:
            raise NotIdentifiableError(
                f"branch {axes[i]}: this motor sees {rows.diagonal.size} modes, {count} masses need "
                f"{count - 1}; use fewer masses or a wider band"
            )
        m, k = springs_and_masses(rows, 1.0 / float(gains.high[i]), count)
        m = np.append(m, last_mass(total, m))
        check_positive(m, k, axis=axes[i])
        masses.append(m)
        springs.append(k)
    couplings = gains.rigid_mass - np.diag(np.diag(gains.rigid_mass))
    try:
        chains = CoupledChains.build(masses, springs, couplings=0.5 * (couplings + couplings.T), axes=axes)
    except ModelError as error:
        raise NotIdentifiableError(f"{error}; measure longer at low frequency or use fewer masses") from None
    return _with_dampers(chains, modes) if dampers else chains


def _with_dampers(chains: CoupledChains, modes: Modes) -> CoupledChains:
    """Dampers ≥ 0 whose modal damping 2ζω matches that of the modes best (relative, NNLS)."""
    count = modes.omega.size
    if count == 0 or chains.dofs - chains.branches != count:
        return chains
    _, shapes = scipy.linalg.eigh(chains.stiffness_matrix, chains.mass_matrix)
    shapes = shapes[:, chains.branches :]
    rows = []
    for start, k in zip(chains.motor_dofs, chains.springs, strict=True):
        for s in range(k.size):
            rows.append((shapes[start + s] - shapes[start + s + 1]) ** 2)
    target = 2 * modes.damping * modes.omega
    values = scipy.optimize.nnls(np.array(rows).T / target[:, None], np.ones(count))[0]
    split = np.split(values, np.cumsum([k.size for k in chains.springs])[:-1])
    return replace(chains, dampers=tuple(np.asarray(d, dtype=np.float64) for d in split))


def _vector(chains: CoupledChains) -> Float64:
    """Masses, springs, couplings in the order of ``model.document.parameter_vector`` without dampers."""
    names, values = parameter_vector(chains)
    vector: Float64 = values[[".damper." not in n for n in names]]
    return vector


def covariance_of(modes: Modes, chains: CoupledChains) -> Float64:
    """Covariance of masses, springs (branch after branch) and couplings (rows of the upper triangle).

    First order, by finite differences through the inverse; entries are NaN where the inverse does not
    survive a step of a tenth of a standard deviation.
    """
    std = np.sqrt(np.maximum(np.diag(modes.covariance), 0.0))
    n, count = modes.shapes.shape
    base = _vector(chains)
    jacobian = np.zeros((base.size, std.size))
    for p in range(2 * n + n * count + int(high_gain_pairs(modes.masses).sum())):
        step = 0.1 * std[p]
        if step <= 0 or n <= p < 2 * n:  # damping ratios do not enter
            continue
        ends = []
        for sign in (1.0, -1.0):
            try:
                moved = _moved(modes, p, sign * step)
                with np.errstate(all="ignore"):
                    gains = gains_of(moved, axes=chains.axes)
                    ends.append(_vector(chains_of(moved, gains, axes=chains.axes, dampers=False)))
            except NotIdentifiableError:
                ends.append(np.full(base.size, np.nan))
        jacobian[:, p] = (ends[0] - ends[1]) / (2 * step)
    covariance: Float64 = jacobian @ modes.covariance @ jacobian.T
    return covariance


def _moved(modes: Modes, place: int, step: float) -> Modes:
    n, count = modes.shapes.shape
    if place < n:
        omega = modes.omega.copy()
        omega[place] *= np.exp(min(step, 5.0))
        return replace(modes, omega=omega)
    if place < 2 * n + n * count:
        shapes = modes.shapes.copy()
        shapes.flat[place - 2 * n] += step
        return replace(modes, shapes=shapes)
    rows, columns = pairs(count)
    at = int(np.flatnonzero(high_gain_pairs(modes.masses))[place - 2 * n - n * count])
    high = modes.high_gain.copy()
    high[rows[at], columns[at]] += step
    if rows[at] != columns[at]:
        high[columns[at], rows[at]] += step
    return replace(modes, high_gain=high)
