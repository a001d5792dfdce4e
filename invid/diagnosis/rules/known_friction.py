"""Rule: the search starts with the friction that the identification fitted along.

An identification that gets masses and springs right beside dry friction has found that friction on every
axis. A search that adds it cause by cause screens and refits the whole catalogue once for each axis and law.
Here all of it enters at once; each law is then tested beside all others and against its rivals, as any cause
is.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from invid.diagnosis.evidence import CandidateEvidence, Step, evidence_if_finite
from invid.diagnosis.selection import Selection
from invid.likelihood.joint_fit import fit, reorder_effects
from invid.likelihood.placed_effect import Candidate
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import SpectralRecord

CHANCE = 0.01
"""Significance of a law's size (statistical). A law that starts without being there is dropped again when it
is tested beside all others; a missing one has to be found."""
LEAST_LAWS = 2
"""Number of laws from which the rule saves time; a single one is found by one step of the search."""


def add_known_friction(
    base: CandidateEvidence,
    friction: Candidate,
    start: Float64 | None,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> Selection | None:
    """The laws of ``friction`` that are significant beside those of ``base``; ``None`` where too few.

    ``start`` (n,): the linear parameters that the identification found with them. The steps have no rivals
    yet, and the gain of each law is not separated from the others'.
    """
    known = base.fit.candidate.terms
    fresh = [k for k, t in enumerate(friction.terms) if all(t.place != other.place for other in known)]
    if len(fresh) < LEAST_LAWS:
        return None
    layout, chosen = base.fit.layout, base.fit.candidate
    for k in fresh:
        chosen = chosen.plus(friction.terms[k], friction.x[k])
    starts = [base.fit.p] if start is None or start.size != base.fit.p.size else [start, base.fit.p]
    tried = (evidence_if_finite(partial(fit, layout, train, p, chosen, iterations=25), held) for p in starts)
    found = next((t for t in tried if t is not None and t.cost < base.cost), None)
    while found is not None:
        count = len(found.fit.candidate.terms)
        sizes = {k: _significance(found, k) for k in range(len(known), count)}
        if len(sizes) < LEAST_LAWS:
            return None
        if all(s > chi2_isf(CHANCE, 1) for s in sizes.values()):
            return _selection_of_laws(base, found, sorted(sizes, key=lambda k: -sizes[k]))
        weakest = min(sizes, key=lambda k: sizes[k])
        rest = found.fit.candidate.without(weakest)
        found = evidence_if_finite(partial(fit, layout, train, found.fit.p, rest, iterations=25), held)
    return None


def _significance(found: CandidateEvidence, number: int) -> float:
    """Squared ratio of size and standard deviation; zero for a size that is not positive."""
    size, variance = float(found.fit.candidate.x[number][0]), float(found.fit.covariance_of(number)[0, 0])
    return size**2 / variance if size > 0.0 and variance > 0.0 else 0.0


def _selection_of_laws(base: CandidateEvidence, found: CandidateEvidence, order: Sequence[int]) -> Selection:
    """The laws as steps of a selection, the most significant first."""
    before = range(len(base.fit.candidate.terms))
    final = CandidateEvidence(reorder_effects(found.fit, [*before, *order]), found.held)
    steps = []
    for k in order:
        others = [other for other in order if other != k]
        chosen = CandidateEvidence(reorder_effects(found.fit, [*before, *others, k]), found.held)
        steps.append(Step(base, chosen, ((chosen, chosen.cost),)))
    return Selection(base, final, tuple(steps))
