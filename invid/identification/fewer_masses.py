"""Identify machines with fewer masses than declared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from invid.errors import InvidError
from invid.likelihood.fit import AT_NOISE, Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.signals.spectra import LineSpectra

FEWER_PHRASE = "were declared, but"
"""Phrase by which the warning about masses that are not seen is recognised."""
MOST_AXES = 2
"""Most axes of which each alone is tried with one mass less (empirical, for the time)."""


class FewerExplain(Exception):
    """Raised by the starts of a structure when smaller chains explain the records."""

    def __init__(self, fit: Fit) -> None:
        super().__init__(f"{fit.structure.sizes} masses explain the records")
        self.fit = fit


def fit_fewer_masses(
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    starts_for: Callable[[tuple[int, ...]], Iterable[CoupledChains]],
) -> Fit | None:
    """The fit with one mass less than ``sizes`` on every axis, or on one, that reaches the noise; else
    ``None``.

    A mass that the records do not show gives starts nothing to go by: its mode is put where the noise is, and
    takes the others with it. Without it they are where they belong. More masses contain fewer, so no further
    mass is seen where fewer reach the noise.
    """
    for fewer in _smaller_structures(tuple(sizes)):
        if budget.is_left_out("fewer masses than declared"):
            break
        structure = ChainStructure(fewer, tuple(axes))
        try:
            first_pass = fit_structure(spectra, structure, starts_for(fewer), thorough=False)
            if first_pass.noise_chi2 < AT_NOISE:
                return fit_structure(spectra, structure, [first_pass.chains])
        except (InvidError, np.linalg.LinAlgError):
            continue
    return None


def fewer_masses_warnings(sizes: Sequence[int], fit: Fit) -> list[str]:
    """Warnings where the fit has other masses than the declared ``sizes``."""
    found = fit.structure.sizes
    if found == tuple(sizes):
        return []
    declared, fewer = (", ".join(str(n) for n in each) for each in (sizes, found))
    return [
        f"masses {declared} {FEWER_PHRASE} {fewer} explain the records to their noise and no further one "
        "is seen, so these are what the model has: declare them, or excite higher frequencies to see more"
    ]


def _smaller_structures(sizes: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Sizes with one mass less wherever there are two or more; of two axes then the same on each alone."""
    one_less_each = tuple(max(n - 1, 1) for n in sizes)
    if one_less_each != sizes:
        yield one_less_each
    for i, n in enumerate(sizes if len(sizes) <= MOST_AXES else ()):
        one = (*sizes[:i], max(n - 1, 1), *sizes[i + 1 :])
        if one not in (sizes, one_less_each):
            yield one
