"""Start from each branch by itself, for branches that hardly move one another.

Two arms alike on a heavy base share every resonance. A rational FRF matrix with as many poles as modes
then has pairs of poles in one place, and a mode that is barely visible is lost among them; seen from one
motor alone every mode is single.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.errors import InvidError
from invid.inverse import starts
from invid.model.chains import CoupledChains
from invid.modes.pole_search import search_modes
from invid.signals.spectra import LineSpectra


def start_separate_branches(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], axes: Sequence[str]
) -> CoupledChains | None:
    """Chains without couplings, each from its own motor's motion and torque; ``None`` where one fails."""
    found: list[CoupledChains] = []
    for i, (size, axis) in enumerate(zip(sizes, axes, strict=True)):
        own = [_single_axis(s, i) for s in spectra if s.excited.any() and (not s.driven.size or s.driven[i])]
        if not own or size < 2:
            return None
        try:
            with np.errstate(all="ignore"):
                modes = search_modes(own, (size,))
                if modes is None:
                    return None
                shape, frf, _ = modes
                chain, *_ = starts(
                    frf.frequency_hz, frf.frf, frf.variance, (size,), axes=(axis,), modes=shape
                )
        except (InvidError, np.linalg.LinAlgError, ValueError):
            return None
        found.append(chain)
    return CoupledChains.build(
        [c.masses[0] for c in found],
        [c.springs[0] for c in found],
        [c.dampers[0] for c in found],
        np.zeros((len(found), len(found))),
        axes=tuple(axes),
    )


def _single_axis(s: LineSpectra, axis: int) -> LineSpectra:
    """The record of one axis alone, for the search for poles."""
    one, both = [axis], [axis, s.axis_count + axis]
    return replace(
        s,
        position=s.position[:, one],
        torque=s.torque[:, one],
        covariance=s.covariance[:, both][:, :, both],
        position_wave=s.position_wave[:, one],
        torque_wave=s.torque_wave[:, one],
        floor=s.floor[both],
        staircase=s.staircase[one],
    )


__all__ = ["start_separate_branches"]
