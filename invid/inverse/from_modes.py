"""From fitted modes to the coupled chains: the paper's inverse on measured data."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from invid.errors import ModelError, NotIdentifiableError
from invid.inverse.lanczos import lanczos
from invid.inverse.springs import check_positive, inverse_end_mass, last_mass, springs_and_masses
from invid.model.chains import CoupledChains
from invid.model.document import parameter_vector
from invid.modes.model import Modes, high_gain_pairs, pairs
from invid.numerics.arrays import Float64

_KEPT_OF_POSITIVE = 0.95  # repaired couplings: this share of the largest still positive definite one


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


def chains_of(
    modes: Modes, gains: Gains, *, axes: tuple[str, ...], repair: bool = False, dampers: bool = True
) -> CoupledChains:
    """Coupled chains from modes and gains, eqs. 13–22 on the weights of the fitted modes.

    The weights φ_ir²/A_iH *are* u1² of eq. 13 (its products over λ and λ0 return them), so the
    recursion starts from them; the antiresonances stay a result for people (``Modes.zeros``).

    Parameters
    ----------
    repair
        Replace what is not physical (a last mass ≤ 0, too large a coupling) by the nearest thing that
        is: for starts of a fit. Otherwise NotIdentifiableError says what came out.
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
        if repair:
            m, k = _repaired_inner(m, k, total)
        end = last_mass(total, m)
        if repair and end <= 0.02 * total:
            end = max(1.0 / inverse_end_mass(rows, float(m[-1]), float(k[-1])), 0.05 * total)
            end = end if np.isfinite(end) else 0.1 * total
        m = np.append(m, end)
        check_positive(m, k, axis=axes[i])
        masses.append(m)
        springs.append(k)
    couplings = gains.rigid_mass - np.diag(np.diag(gains.rigid_mass))
    if repair:
        couplings = couplings * _admissible_share(np.array([m[-1] for m in masses]), couplings)
    try:
        chains = CoupledChains.build(masses, springs, couplings=0.5 * (couplings + couplings.T), axes=axes)
    except ModelError as error:
        raise NotIdentifiableError(f"{error}; measure longer at low frequency or use fewer masses") from None
    return _with_dampers(chains, modes) if dampers else chains


def _repaired_inner(m: Float64, k: Float64, total: float) -> tuple[Float64, Float64]:
    """Positive inner masses and springs, masses within the branch sum."""
    m = np.where(np.isfinite(m) & (m > 0), m, 0.5 * total / (m.size + 1))
    good = k[np.isfinite(k) & (k > 0)]
    k = np.where(np.isfinite(k) & (k > 0), k, np.median(good) if good.size else 1.0)
    if m.sum() > 0.98 * total:
        m = m * (0.9 * total / m.sum())
    return m, k


def _admissible_share(ends: Float64, couplings: Float64) -> float:
    normal = couplings / np.sqrt(np.outer(ends, ends))
    smallest = float(np.linalg.eigvalsh(normal)[0])
    return 1.0 if smallest > -_KEPT_OF_POSITIVE else _KEPT_OF_POSITIVE / -smallest


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


def low_frequency_mass(
    frequency_hz: npt.ArrayLike, frf: npt.ArrayLike, first_antiresonance: float
) -> Float64 | None:
    """(M, M) S = lim −Re G⁻¹/ω², extrapolated in ω² with degree 2 below a third of the first
    antiresonance [rad/s]; real parts, as magnitudes carry friction. ``None`` with too few lines.
    """
    w = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
    pick = w < first_antiresonance / 3
    degree = 2 if pick.sum() >= 6 else 1
    if pick.sum() < 3:
        return None
    try:
        rigid = -np.linalg.inv(np.asarray(frf)[pick]).real / w[pick, None, None] ** 2
    except np.linalg.LinAlgError:
        return None
    rigid = 0.5 * (rigid + rigid.transpose(0, 2, 1))
    x = (w[pick] / w[pick].max()) ** 2
    # position noise and friction enter −Z/ω² as 1/ω²: weight rising with ω²
    basis = np.vander(x, degree + 1, increasing=True) * x[:, None]
    solution = np.linalg.lstsq(basis, (x[:, None] * rigid.reshape(x.size, -1)), rcond=None)[0]
    mass: Float64 = solution[0].reshape(rigid.shape[1:])
    return mass
