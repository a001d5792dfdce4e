"""Correct starts for torque that acts later than recorded by more than a sampling convention."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from invid.errors import InvidError
from invid.likelihood.fit import Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Float64
from invid.signals.spectra import LineSpectra

MOST_COST = 0.5
"""Share of χ² to which the corrected fit must come. Empirical: a wrong minimum of a late machine was off 40
000 times, while a machine that the model does not explain costs about the same from every start."""


def refit_with_late_torque(
    spectra: Sequence[LineSpectra],
    fit: Fit,
    starts_for: Callable[[Sequence[LineSpectra]], Iterable[CoupledChains]],
) -> Fit:
    """The fit from starts with the torque delayed as ``fit`` found it, where that is more than a sample.

    A late torque takes poles of every rational fit that starts are drawn from, but even a fit in a wrong
    minimum shows the delay: no mass, spring or damper turns the phase in proportion to frequency.
    """
    delays = _torque_delays(fit)
    if not (np.abs(delays) > 1.0 / spectra[0].sample_rate_hz).any():
        return fit
    delayed = [replace(s, torque=s.torque * np.exp(-1j * s.omega[:, None] * delays)) for s in spectra]
    structure = ChainStructure(fit.structure.sizes, fit.structure.axes)
    try:
        first_pass = fit_structure(delayed, structure, starts_for(delayed), thorough=False)
        found = fit_structure(spectra, structure, [first_pass.chains])
    except (InvidError, np.linalg.LinAlgError):
        return fit
    return found if found.noise_cost < MOST_COST * fit.noise_cost else fit


def _torque_delays(fit: Fit) -> Float64:
    """(M,) delay [s] of each torque against the recorded one."""
    offsets = fit.facts.get("time_offset_s", {})
    return np.array(
        [float(offsets.get(f"{a}.time_offset", {}).get("value", 0.0)) for a in fit.structure.axes]
    )
