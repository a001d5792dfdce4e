"""Torque that acts later than recorded by more than sampling convention: starts drawn with that taken out."""

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

PAYS = 0.5
"""Share of χ² to which the fit from timely starts must come, a guess: a wrong minimum of a late machine was
off 40 000 times, while one that the model does not explain costs about the same from every start."""


def refit_with_late_torque(
    spectra: Sequence[LineSpectra],
    fit: Fit,
    starts_for: Callable[[Sequence[LineSpectra]], Iterable[CoupledChains]],
) -> Fit:
    """The fit from starts with the torque as late as ``fit`` found it, where that is more than a sample.

    A late torque takes poles of every rational fit that starts are drawn from, but even a fit that ends in a
    wrong minimum for it tells how late it is: no mass, spring or damper turns the phase in proportion to
    frequency.
    """
    late = _lateness(fit)
    if not (np.abs(late) > 1.0 / spectra[0].sample_rate_hz).any():
        return fit
    turned = [replace(s, torque=s.torque * np.exp(-1j * s.omega[:, None] * late)) for s in spectra]
    structure = ChainStructure(fit.structure.sizes, fit.structure.axes)
    try:
        begun = fit_structure(turned, structure, starts_for(turned), thorough=False)
        found = fit_structure(spectra, structure, [begun.chains])
    except (InvidError, np.linalg.LinAlgError):
        return fit
    return found if found.noise_cost < PAYS * fit.noise_cost else fit


def _lateness(fit: Fit) -> Float64:
    """(M,) how much later than recorded each torque acts [s]."""
    offsets = fit.facts.get("time_offset_s", {})
    return np.array(
        [float(offsets.get(f"{a}.time_offset", {}).get("value", 0.0)) for a in fit.structure.axes]
    )
