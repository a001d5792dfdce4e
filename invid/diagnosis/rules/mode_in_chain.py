"""Rule: a mode found beside a chain that is one of the chain's own, which the fit has lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy.linalg

from invid.diagnosis.evidence import CandidateEvidence, evidence_if_finite
from invid.errors import InvidError
from invid.inverse import chains_of, gains_of
from invid.likelihood.joint_fit import JointFit, fit
from invid.model.chains import CoupledChains
from invid.modes.model import modes_of_matrices
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

CHAIN_ITERATIONS = 20
"""Iterations of a fit that starts from the chain with the mode in it (empirical: ten are enough)."""


def fit_chain_with_mode(
    last: CandidateEvidence,
    rest: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """The fit of a chain that contains the mode found beside it; ``None`` where it is no better than
    ``rest``.

    ``last`` is the fit with the mode beside the chain, ``rest`` that of the chain without it.
    """
    own = chain_parameters_with_mode(last.fit, train)
    if own is None:
        return None
    candidate = replace(rest.fit.candidate, x=last.fit.candidate.x[:-1])
    found = evidence_if_finite(
        partial(fit, rest.fit.layout, train, own, candidate, iterations=CHAIN_ITERATIONS), held
    )
    return None if found is None or found.cost > rest.cost else found


def chain_parameters_with_mode(fitted: JointFit, records: Sequence[SpectralRecord]) -> Float64 | None:
    """(n,) parameters of chains that contain the mode beside them; ``None`` where there are no such chains.

    The mode, the last effect of ``fitted``, takes the place of the mode that the records show least. A fit in
    another minimum has a light mass where the machine has a mode, and the mode then shows beside the chain.
    The receptance of the two together is known to the noise, and chains follow from the modes at the motors
    (the paper's inverse) without a search.
    """
    structure = fitted.layout.structure
    term, x = fitted.candidate.terms[-1], fitted.candidate.x[-1]
    if term.effect.cause != "extra_mode" or structure.grounded:
        return None
    found = term.effect.values(x.tolist(), term.place)
    mass, damping, stiffness = structure.matrices(fitted.p[: structure.count])
    (at, _), *_ = term.place.pattern(structure)
    damper = 2.0 * found["damping_ratio"] * float(np.sqrt(found["mass"] * found["stiffness"]))
    mass = scipy.linalg.block_diag(mass, found["mass"])
    damping, stiffness = (
        _attach_mode(matrix, at, size)
        for matrix, size in ((damping, damper), (stiffness, found["stiffness"]))
    )
    all_modes = modes_of_matrices(mass, damping, stiffness, structure.motor_dofs, structure.sizes)
    omega, ratio, shapes = all_modes.omega, all_modes.damping, all_modes.shapes
    excited = np.concatenate([r.omega[r.excited] for r in records])[:, None]
    gain = np.abs(excited**2 / (omega**2 - excited**2 + 2j * ratio * omega * excited)) ** 2
    kept = np.arange(omega.size) != int(np.argmin(gain.sum(axis=0) * (shapes**2).sum(axis=1) ** 2))
    rigid = all_modes.high_gain - shapes.T @ shapes
    modes = replace(
        all_modes,
        omega=omega[kept],
        damping=ratio[kept],
        shapes=shapes[kept],
        high_gain=rigid + shapes[kept].T @ shapes[kept],
    )
    try:
        with np.errstate(all="ignore"):
            chains = chains_of(modes, gains_of(modes, axes=structure.axes), axes=structure.axes, repair=True)
    except (InvidError, np.linalg.LinAlgError, ValueError):
        return None
    return _parameters_with_chains(fitted, chains) if _is_finite(chains) else None


def _attach_mode(matrix: Float64, at: int, size: float) -> Float64:
    """(ΣN + 1, ΣN + 1) matrix with one coordinate more and a spring or damper of ``size`` between it and
    ``at``."""
    out = scipy.linalg.block_diag(matrix, size)
    out[at, at] += size
    out[at, -1] = out[-1, at] = -size
    return np.asarray(out, dtype=float)


def _is_finite(chains: CoupledChains) -> bool:
    return all(bool(np.isfinite(v).all()) for part in (chains.masses, chains.springs) for v in part)


def _parameters_with_chains(fitted: JointFit, chains: CoupledChains) -> Float64:
    structure = fitted.layout.structure
    p = fitted.p.copy()
    p[: structure.count] = structure.vector(chains)
    return p


__all__ = ["chain_parameters_with_mode", "fit_chain_with_mode"]
