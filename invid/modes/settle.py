"""Transients taken out of records from rest, so that Θ = G T holds line by line.

A record that does not repeat carries the free motion between its ends: on every line
Σ_r φ_r (α_r + jωβ_r)/D_r + (γ + jωδ)/ω², with the same modes as G and 2(n + M) real unknowns a record.
Modes from a smoothed FRF are good enough to find them; what is left is fitted again, until the
resonances stay. The case study (two periods from rest, friction) goes from 80 % error in a spring to
0.1 % in a round; worse starts take half a dozen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.errors import InvidError
from invid.modes.fit import fit_modes
from invid.modes.model import Modes
from invid.numerics.arrays import Complex128
from invid.numerics.linear_algebra import least_squares, real_rows
from invid.signals.frf import FrfMatrix, frf_matrix, local_frf_matrix
from invid.signals.spectra import LineSpectra

_ROUNDS = 8
_SAME = 3e-5
"""Relative change of the resonances at which the rounds end: a thirtieth of what friction costs."""
_MODEL_ERROR = 0.03
"""Relative error granted to the smoothed FRF when the transients are weighed; empirical (case study)."""


def settled_frf(spectra: Sequence[LineSpectra], modes: Modes, measured: FrfMatrix) -> FrfMatrix:
    """The FRF matrix of ``spectra`` with the transients of unsettled records taken out.

    Parameters
    ----------
    modes
        To start from.
    measured
        A first FRF matrix, blunted by transients or by smoothing; returned where nothing is to be
        settled, or where the modes cannot be found in it.
    """
    if not any(s.transient for s in spectra):
        return measured
    modes = fit_modes(measured.frequency_hz, measured.frf, measured.variance, modes.masses)
    for _ in range(_ROUNDS):
        try:
            settled = [settled_spectra(s, modes) for s in spectra]
            found = frf_matrix(settled)
            if found.frequency_hz.size < 2 * modes.omega.size + 2:
                found = local_frf_matrix(settled)
            if found.frequency_hz.size < 2 * modes.omega.size + 2:
                return measured
            measured, before = found, modes.omega
            modes = fit_modes(found.frequency_hz, found.frf, found.variance, modes.masses)
        except (InvidError, np.linalg.LinAlgError):
            return measured
        if np.max(np.abs(modes.omega / before - 1), initial=0.0) < _SAME:
            break
    return measured


def settled_spectra(spectra: LineSpectra, modes: Modes) -> LineSpectra:
    """One record without its transient, the modes taken as they are; as it was where it is settled."""
    if not spectra.transient:
        return spectra
    w = spectra.omega
    missing = spectra.position - np.einsum("fij,fj->fi", modes.response(w), spectra.torque)
    basis = _free_motion(modes, spectra)
    size = np.abs(spectra.position)
    weight = 1.0 / (_MODEL_ERROR * size + 1e-3 * np.median(size, axis=0) + np.finfo(float).tiny)
    matrix = (weight[:, :, None] * basis).reshape(-1, basis.shape[2])
    target = (weight * missing).ravel()
    amplitudes = least_squares(real_rows(matrix), real_rows(target), rcond=1e-10)
    return replace(spectra, position=spectra.position - basis @ amplitudes, transient=False)


def _free_motion(modes: Modes, spectra: LineSpectra) -> Complex128:
    """(F, M, 2n + 3M) spectra of all free motions."""
    w = spectra.omega[:, None]
    resonant = 1.0 / (modes.omega**2 - w**2 + 2j * modes.damping * modes.omega * w)
    shapes = resonant[:, None, :] * modes.shapes.T[None, :, :]
    rigid = np.eye(spectra.axis_count)[None] / (w**2)[:, :, None]
    turned = 1j * w[:, :, None]
    # a jump between the ends of a sampled record leaves a constant beside its 1/jω
    flat = np.broadcast_to(np.eye(spectra.axis_count), rigid.shape)
    basis: Complex128 = np.concatenate((shapes, turned * shapes, rigid, turned * rigid, flat), axis=2)
    return basis
