"""Starts of the fit of one order: the rational fits' modes through the paper's inverse, then cruder ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from invid.identification.crosscheck import FreeFrf
from invid.identification.fewer_masses import FewerExplain, fit_fewer_masses
from invid.identification.grown_chain import grow_chains
from invid.identification.separate_branches import start_separate_branches
from invid.inverse import starts
from invid.likelihood.fit import Fit, fit_structure, is_costly_to_start
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.modes import Modes
from invid.modes.pole_search import search_modes
from invid.modes.rational_fit import FINE, TRUSTED, rational_modes
from invid.numerics import budget
from invid.signals.frf import FrfMatrix, frf_matrix, local_frf_matrix
from invid.signals.spectra import LineSpectra

MISFIT = 0.01
"""Relative FRF error of the modal fit that only gives a start. Empirical: friction of a few per cent of the
peak torque leaves about that, and a tighter modal fit is slow and no better a start."""
LOCAL_MISFIT = 0.03
"""The same for the local regression, which blunts resonances narrower than its window."""


def measured_frf(spectra: Sequence[LineSpectra], *, misfit: float = MISFIT) -> FrfMatrix:
    """The FRF matrix for starts; ``misfit`` is added to its relative errors."""
    frf = FrfMatrix.empty(spectra[0].axis_count)
    if not any(s.transient for s in spectra):
        frf = frf_matrix(spectra)
    if frf.frequency_hz.size < 8:
        frf, misfit = local_frf_matrix(spectra), max(misfit, LOCAL_MISFIT)
    return replace(frf, variance=frf.variance + (misfit * np.abs(frf.frf)) ** 2)


def fit_sizes(  # noqa: PLR0913 - where starts come from
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    measured: FrfMatrix,
    *,
    thorough: bool = True,
    further: Sequence[CoupledChains] = (),
    declared: bool = False,
) -> Fit:
    """The fit of one order, from the paper's inverse and its fallbacks.

    ``declared``: where the first starts fail a smaller order that explains the records takes its place.
    """
    structure = ChainStructure(tuple(sizes), tuple(axes))
    attempts = chain_starts(spectra, sizes, axes, measured, further, thorough, declared)
    try:
        free = FreeFrf(spectra, sizes)
        return fit_structure(spectra, structure, attempts, thorough=thorough, free=free)
    except FewerExplain as found:
        return found.fit


def fewer_masses(spectra: Sequence[LineSpectra], sizes: Sequence[int], axes: Sequence[str]) -> Fit | None:
    """The fit of a smaller order, where one explains the records."""

    def starts_for(fewer: tuple[int, ...]) -> Iterator[CoupledChains]:
        return chain_starts(spectra, fewer, axes, measured_frf(spectra), (), False)

    return fit_fewer_masses(spectra, sizes, axes, starts_for)


def chain_starts(  # noqa: PLR0913 - where starts come from
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    measured: FrfMatrix,
    further: Sequence[CoupledChains],
    thorough: bool,
    declared: bool = False,
) -> Iterator[CoupledChains]:
    """Starts, most trusted first; each is made only when those before it have failed."""
    yield from further
    # Of axes that move together an FRF is read badly without a period (those that still settle are periods).
    together = all(s.transient and s.periods == 1 and s.driven.sum() != 1 for s in spectra)
    is_grown_first = thorough and len(sizes) > 1 and together
    if is_grown_first:
        yield from _grown(spectra, sizes, axes)
    crude: list[CoupledChains] = []
    count = 0
    try_frf_first = not is_costly_to_start(sizes) and measured.frequency_hz.size > 0
    for modes, frf in _modal_starts(spectra, sizes, thorough):
        if count and budget.is_spent():
            break
        *physical, equal = starts(frf.frequency_hz, frf.frf, frf.variance, sizes, axes=axes, modes=modes)
        yield from physical
        crude.append(equal)
        if not count and try_frf_first and not budget.is_spent():
            # Branches alike share poles, which as many poles as modes cannot fit; the modes of the FRF matrix
            # can, and take less time than a search under the noise.
            *shared, equal = starts(measured.frequency_hz, measured.frf, measured.variance, sizes, axes=axes)
            yield from shared
            crude.insert(0, equal)
            separate = start_separate_branches(spectra, sizes, axes) if thorough and len(sizes) > 1 else None
            if separate is not None:
                yield separate
        if declared and not count and budget.is_left_out("fewer masses than declared"):
            declared = False
        fewer = fewer_masses(spectra, sizes, axes) if declared and not count else None
        if fewer is not None:
            raise FewerExplain(fewer)
        if not count and thorough and not is_grown_first:
            yield from _grown(spectra, sizes, axes)
        count += 1
    if count and not thorough:
        return
    if (not count or not try_frf_first) and measured.frequency_hz.size:
        yield from starts(measured.frequency_hz, measured.frf, measured.variance, sizes, axes=axes)
    yield from crude


def _grown(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], axes: Sequence[str]
) -> Iterator[CoupledChains]:
    if max(sizes) > 1 and not budget.is_spent():
        grown = grow_chains(spectra, sizes, axes)
        if grown is not None:
            yield grown


def _modal_starts(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], thorough: bool
) -> Iterator[tuple[Modes, FrfMatrix]]:
    """Rational fits, each made only when those before it have failed: quick, thorough, fine."""
    found = rational_modes(spectra, sizes, trusted=TRUSTED)
    if found is not None:
        yield found
    for model_error in (0.0, FINE) if thorough else (0.0,):
        search = search_modes(spectra, sizes, model_error=model_error)
        if search is not None:
            yield search[:2]
    if thorough:
        found = rational_modes(spectra, sizes, trusted=FINE)
        if found is not None:
            yield found
