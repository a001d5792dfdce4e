"""A mode found beside a chain that was given fewer masses than were declared: the chain's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.search_pass import Look, looked
from invid.diagnosis.thresholds import SIGNIFICANCE
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.errors import InvidError
from invid.identification.fewer_masses import BUT
from invid.inverse import lanczos, last_mass, springs_and_masses
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf


def with_the_declared_mass(look: Look, declared: Sequence[int] | str | None) -> Look:
    """The look, or one through a chain with the mass in it that the identification did not see.

    Where fewer masses explain the records to their noise the identification takes those. The search for
    causes is finer: what it then finds beside the chain is the mass that was declared (an empty record of
    three masses had a mode at 0.999). Kept where the longer chain leaves as little without the mode.
    """
    final, sizes = look.selection.final, look.model.chains.masses_per_branch
    if not look.selection.steps or declared is None or isinstance(declared, str):
        return look
    if len(declared) != len(sizes):
        return look
    chains = look.model.chains
    for step in look.selection.steps:
        term = step.chosen.term
        axis = term.place.axis
        if isinstance(term.effect, ExtraMode) and sizes[axis] + 1 == declared[axis]:
            values = term.effect.values(step.chosen.x.tolist(), term.place)
            chains = _longer(chains, axis, term.place.number - 1, values["mass"], values["stiffness"])
    if chains is look.model.chains:
        return look
    warnings = tuple(w for w in look.model.warnings if BUT not in w)
    try:
        other = looked(look.recording, replace(look.model, chains=chains, covariance=None, warnings=warnings))
    except (InvidError, np.linalg.LinAlgError, ValueError):
        return look
    # A mode has three numbers, a mass with its spring and damper as many.
    as_good = other.selection.final.cost < final.cost + chi2_isf(SIGNIFICANCE, 3) * final.dispersion
    return other if as_good and len(other.selection.steps) < len(look.selection.steps) else look


def _longer(chains: CoupledChains, axis: int, at: int, mass: float, stiffness: float) -> CoupledChains:
    """The chains with a mass on a spring at mass ``at`` of an axis taken into its chain.

    Of a free chain alone: the one that answers alike at the motor, by the paper's inverse (eqs. 14 to 22).
    """
    masses: Float64 = np.append(chains.masses[axis], mass)
    springs, n = chains.springs[axis], masses.size
    stiff = np.zeros((n, n))
    stiff[:-1, :-1] = CoupledChains.build([masses[:-1]], [springs]).stiffness_matrix
    stiff[np.ix_([at, n - 1], [at, n - 1])] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    root = np.sqrt(masses)
    poles, vectors = np.linalg.eigh(stiff / root[:, None] / root)
    rows = lanczos(np.maximum(poles, 0.0), vectors[0], n - 1)
    own, other = springs_and_masses(rows, float(masses[0]), n)
    own = np.append(own, last_mass(float(masses.sum()), own))
    loss = float(np.mean(chains.dampers[axis] / springs)) if springs.size else 0.0
    return CoupledChains.build(
        [own if i == axis else m for i, m in enumerate(chains.masses)],
        [other if i == axis else k for i, k in enumerate(chains.springs)],
        [loss * other if i == axis else d for i, d in enumerate(chains.dampers)],
        chains.couplings,
        ground_springs=chains.ground_springs,
        ground_dampers=chains.ground_dampers,
        axes=chains.axes,
    )


__all__ = ["with_the_declared_mass"]
