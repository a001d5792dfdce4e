"""Machines with fewer masses than declared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from invid.errors import InvidError
from invid.likelihood.fit import AT_NOISE, Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.signals.spectra import LineSpectra

BUT = "were declared, but"
"""What the warning about masses that are not seen is known by."""
SINGLY = 2
"""Axes up to which one mass less is tried on each alone. A guess, for the time that it takes."""


class FewerExplain(Exception):
    """Raised by starts for a structure when smaller chains turn out to explain the records."""

    def __init__(self, fit: Fit) -> None:
        super().__init__(f"{fit.structure.sizes} masses explain the records")
        self.fit = fit


def fit_fewer_masses(
    spectra: Sequence[LineSpectra],
    sizes: Sequence[int],
    axes: Sequence[str],
    starts_for: Callable[[tuple[int, ...]], Iterable[CoupledChains]],
) -> Fit | None:
    """The fit with one mass less than ``sizes`` on every axis, or on one of them, that explains the records
    to their noise; none where there is none.

    A mass that the records do not show leaves starts nothing to go by: the mode that is not there is put
    where the noise is, and takes the others with it. Fitted without it they are where they belong. More
    masses contain fewer, so in what these explain no further mass is seen.
    """
    for fewer in _smaller(tuple(sizes)):
        if budget.is_left_out("fewer masses than declared"):
            break
        structure = ChainStructure(fewer, tuple(axes))
        try:
            begun = fit_structure(spectra, structure, starts_for(fewer), thorough=False)
            if begun.noise_chi2 < AT_NOISE:
                return fit_structure(spectra, structure, [begun.chains])
        except (InvidError, np.linalg.LinAlgError):
            continue
    return None


def fewer_masses_warnings(sizes: Sequence[int], fit: Fit) -> list[str]:
    """What to warn about where the fit has other masses than the ``sizes`` that were declared."""
    found = fit.structure.sizes
    if found == tuple(sizes):
        return []
    declared, fewer = (", ".join(str(n) for n in each) for each in (sizes, found))
    return [
        f"masses {declared} {BUT} {fewer} explain the records to their noise and no further one "
        "is seen, so these are what the model has: declare them, or excite higher frequencies to see more"
    ]


def _smaller(sizes: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """One mass less wherever there are two or more; of two axes then the same on each alone.

    Of more axes that would be a fit of seconds each, in every case whose starts fail for another reason.
    """
    every = tuple(max(n - 1, 1) for n in sizes)
    if every != sizes:
        yield every
    for i, n in enumerate(sizes if len(sizes) <= SINGLY else ()):
        one = (*sizes[:i], max(n - 1, 1), *sizes[i + 1 :])
        if one not in (sizes, every):
            yield one
