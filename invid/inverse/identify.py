"""Measured FRF matrix to the coupled chains with no start values, and starts for the refined fit."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from invid.errors import InvidError, NotIdentifiableError
from invid.inverse.from_modes import Gains, chains_of, covariance_of, gains_of, low_frequency_mass
from invid.model.chains import CoupledChains
from invid.model.document import parameter_vector
from invid.modes import Modes, fit_modes
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class PaperResult:
    """What the paper's method gives.

    Attributes
    ----------
    chains
        Masses, springs, couplings; dampers fitted to the modal damping.
    modes
        Poles, shapes, asymptotes with covariance; ``modes.zeros(axis)`` are the antiresonances.
    gains
        A_H and the rigid mass matrix.
    covariance
        Of masses and springs (branch after branch: masses then springs) and couplings (i < j).
    """

    chains: CoupledChains
    modes: Modes
    gains: Gains
    covariance: Float64
    warnings: tuple[str, ...] = ()

    @property
    def named(self) -> dict[str, tuple[float, float]]:
        """Value and variance of every parameter of ``covariance``, in its order."""
        names, values = parameter_vector(self.chains)
        known = [(n, float(v)) for n, v in zip(names, values, strict=True) if ".damper." not in n]
        variance = np.diag(self.covariance)
        return {n: (v, float(s)) for (n, v), s in zip(known, variance, strict=True)}


def identify_paper(
    frequency_hz: npt.ArrayLike,
    frf: npt.ArrayLike,
    frf_variance: npt.ArrayLike,
    masses: Sequence[int],
    *,
    axes: Sequence[str] | None = None,
    start: Modes | None = None,
) -> PaperResult:
    """The paper's method on a measured receptance matrix: modes, gains, eqs. 13–22, couplings.

    Parameters are those of ``invid.modes.fit_modes``.

    Raises
    ------
    NotIdentifiableError
        Where what came out is no physical chain; says which branch and value.
    """
    names = _names(axes, len(masses))
    modes = fit_modes(frequency_hz, frf, frf_variance, masses, start=start)
    gains = gains_of(modes, axes=names)
    chains = chains_of(modes, gains, axes=names)
    covariance = covariance_of(modes, chains)
    return PaperResult(chains, modes, gains, covariance, _warnings(modes, frequency_hz, names))


def starts(
    frequency_hz: npt.ArrayLike,
    frf: npt.ArrayLike,
    frf_variance: npt.ArrayLike,
    masses: Sequence[int],
    *,
    axes: Sequence[str] | None = None,
    modes: Modes | None = None,
) -> list[CoupledChains]:
    """Physical starts for a fit, most trusted first; never empty, never raises on noisy data.

    1. modes and the sum rule; 2. the same modes with S from the low-frequency extrapolation of −Z/ω²;
    3. equal shares of the branch sums with springs at the modes' mean, for when neither is physical.
    """
    names = _names(axes, len(masses))
    fitted = fit_modes(frequency_hz, frf, frf_variance, masses) if modes is None else modes
    found: list[CoupledChains] = []
    low = _low(frequency_hz, frf, fitted)
    candidates: list[Gains] = []
    with contextlib.suppress(NotIdentifiableError):
        candidates.append(gains_of(fitted, axes=names))
    high = np.diag(fitted.high_gain).copy()
    if low is not None:
        fallback = 2.0 * fitted.shapes.max(initial=1e-6) ** 2
        candidates.append(Gains(np.where(high > 0, high, fallback), low))
    for gains in candidates:
        for repair in (False, True):
            try:
                found.append(chains_of(fitted, gains, axes=names, repair=repair))
                break
            except (InvidError, np.linalg.LinAlgError):
                continue
    found.append(_equal_shares(fitted, candidates[0].rigid_mass if candidates else None, names))
    return found


def _names(axes: Sequence[str] | None, count: int) -> tuple[str, ...]:
    return tuple(axes) if axes is not None else tuple(f"A{i + 1}" for i in range(count))


def _low(frequency_hz: npt.ArrayLike, frf: npt.ArrayLike, modes: Modes) -> Float64 | None:
    notches = [modes.zeros(i)[0] for i in range(len(modes.masses))]
    moving = np.concatenate([z[z > 0] for z in notches]) if notches else np.zeros(0)
    top = 2 * np.pi * float(np.max(np.asarray(frequency_hz)))
    low = low_frequency_mass(frequency_hz, frf, float(moving.min()) if moving.size else 3 * top)
    if low is None or not np.isfinite(low).all() or np.linalg.eigvalsh(low)[0] <= 0:
        return None
    return low


def _equal_shares(modes: Modes, rigid: Float64 | None, axes: tuple[str, ...]) -> CoupledChains:
    count = len(modes.masses)
    high = np.abs(np.diag(modes.high_gain))
    sums = np.diag(rigid) if rigid is not None else 3.0 / np.maximum(high, 1e-9)
    sums = np.where(np.isfinite(sums) & (sums > 0), sums, 1.0)
    middle = float(np.median(modes.omega)) if modes.omega.size else 1.0
    masses = [np.full(n, sums[i] / n) for i, n in enumerate(modes.masses)]
    springs = [np.full(n - 1, middle**2 * sums[i] / n / 2) for i, n in enumerate(modes.masses)]
    damping = float(np.median(modes.damping)) if modes.omega.size else 0.0
    dampers = [2 * min(damping, 0.05) * k / middle for k in springs]
    return CoupledChains.build(masses, springs, dampers, np.zeros((count, count)), axes=axes)


def _warnings(modes: Modes, frequency_hz: npt.ArrayLike, axes: tuple[str, ...]) -> tuple[str, ...]:
    found = []
    top = 2 * np.pi * float(np.max(np.asarray(frequency_hz, dtype=float)))
    beyond = modes.omega[modes.omega > top]
    if beyond.size:
        found.append(
            f"{beyond.size} of {modes.omega.size} resonances lie above the measured band "
            f"({', '.join(f'{x / 2 / np.pi:.4g}' for x in beyond)} Hz above {top / 2 / np.pi:.4g} Hz): "
            "widen the band or use fewer masses"
        )
    if modes.model_error > 0.02:
        found.append(
            f"the modes explain the FRF to {100 * modes.model_error:.2g} % only, more than its noise: "
            "friction, strong damping or another number of masses; standard deviations include that error "
            "as if it were noise"
        )
    for i, axis in enumerate(axes):
        if modes.masses[i] > 1:
            zeros, std = modes.zeros(i)
            unsure = std > 0.1 * np.maximum(zeros, 1e-300)
            if unsure.any():
                found.append(
                    f"branch {axis}: {int(unsure.sum())} of {zeros.size} antiresonances are known to no "
                    "better than 10 %: measure longer or raise the amplitude"
                )
    return tuple(found)
