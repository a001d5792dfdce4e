"""Parameters by name (``A1.mass.1``, ``A1-A2.coupling``) back into the shapes of chains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.document import ChainStd
from invid.numerics.arrays import Float64, frozen_float


def std_by_name(chains: CoupledChains, std: Mapping[str, float]) -> ChainStd:
    """Standard deviations in the shapes of ``chains``; NaN for names that ``std`` does not have."""
    masses, springs, dampers, couplings, ground = _shaped(chains, std)
    return ChainStd(
        masses=masses, springs=springs, dampers=dampers, couplings=couplings, ground_springs=ground
    )


def chains_by_name(chains: CoupledChains, values: Mapping[str, float]) -> CoupledChains:
    """``chains`` with the parameters named in ``values``; the others stay as they are."""
    masses, springs, dampers, couplings, ground = _shaped(chains, values)

    def filled(new: Float64, old: Float64) -> Float64:
        return frozen_float(np.where(np.isnan(new), old, new))

    return replace(
        chains,
        masses=tuple(filled(n, o) for n, o in zip(masses, chains.masses, strict=True)),
        springs=tuple(filled(n, o) for n, o in zip(springs, chains.springs, strict=True)),
        dampers=tuple(filled(n, o) for n, o in zip(dampers, chains.dampers, strict=True)),
        couplings=filled(couplings, chains.couplings),
        ground_springs=filled(ground, chains.ground_springs),
    )


def _shaped(
    chains: CoupledChains, named: Mapping[str, float]
) -> tuple[tuple[Float64, ...], tuple[Float64, ...], tuple[Float64, ...], Float64, Float64]:
    """Masses, springs, dampers, couplings, springs to ground; NaN where not named."""

    def column(kind: str, parts: tuple[Float64, ...]) -> tuple[Float64, ...]:
        return tuple(
            frozen_float([named.get(f"{axis}.{kind}.{q + 1}", np.nan) for q in range(part.size)])
            for axis, part in zip(chains.axes, parts, strict=True)
        )

    couplings = np.full((chains.branches, chains.branches), np.nan)
    for i, a in enumerate(chains.axes):
        for j in range(i + 1, chains.branches):
            value = named.get(f"{a}-{chains.axes[j]}.coupling", np.nan)
            couplings[i, j] = couplings[j, i] = value
    return (
        column("mass", chains.masses),
        column("spring", chains.springs),
        column("damper", chains.dampers),
        frozen_float(couplings),
        frozen_float([named.get(f"{a}.ground_spring", np.nan) for a in chains.axes]),
    )
