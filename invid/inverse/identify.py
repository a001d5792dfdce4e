"""Measured FRF matrix to the coupled chains with no start values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from invid.inverse.from_modes import Gains, chains_of, covariance_of, gains_of
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


def _names(axes: Sequence[str] | None, count: int) -> tuple[str, ...]:
    return tuple(axes) if axes is not None else tuple(f"A{i + 1}" for i in range(count))


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
