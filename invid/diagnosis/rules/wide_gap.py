"""A gap as wide as its spring deflects, where the search for causes ended far from the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.acceptance import accepted
from invid.diagnosis.evidence import Step, Trial, at_bound, attempted, finite
from invid.diagnosis.rules.wide_gap_fit import FreePlay, widest_gap
from invid.diagnosis.score_test import terms_for
from invid.diagnosis.selection import is_far
from invid.diagnosis.thresholds import LEFT
from invid.effects.catalogue.backlash import RattlingBacklash
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.placed_effect import Candidate, Term
from invid.model.place import spring_places
from invid.signals.spectral_record import Record

CUBIC = 0.1
"""Share of what the best cubic spring leaves of the force that a gap may leave at most. A guess: of hidden
gaps that were found it was a hundredth and less."""


def rattles(base: Trial, train: Sequence[Record], held: Sequence[Record]) -> Step | None:
    """A gap beside which less is left than of any other cause that may be named; none where there is none."""
    if not is_far(base):
        return None
    structure = base.fit.layout.structure
    terms = [Term(RattlingBacklash(), place) for place in spring_places(structure)]
    with np.errstate(all="ignore"):
        try:
            found = widest_gap(base.fit, train, terms)
        except (np.linalg.LinAlgError, ValueError):  # nothing finite follows from any start
            return None
    if found is None:
        return None
    term, free = found
    candidate = Candidate((term,), (np.array([free.width]),))
    play = FreePlay(base.fit.layout, train, term)

    def joined() -> JointFit:
        there = fit(base.fit.layout, train, free.p, candidate, iterations=0)
        return replace(there, covariance=play.covariance(free), converged=True)

    trial = attempted(joined, held)
    if trial is None or at_bound(trial.fit):
        return None
    if trial.fit.cost - trial.fit.dof > LEFT * (base.fit.cost - base.fit.dof):
        return None
    if trial.held.cost - trial.held.dof > LEFT * (base.held.cost - base.held.dof):
        return None
    count = len(terms_for(structure, linear_axes=False))
    apart = trial.fit.dispersion, trial.held_dispersion
    if not accepted(base, trial, apart, count, base, first=True, rejects=True, quiet=False):
        return None
    # Where the linear parameters alone gain more than the gap, it is no gap's doing.
    alone = finite(lambda: fit(base.fit.layout, train, free.p, Candidate(), iterations=20))
    if alone is not None and base.fit.cost - alone.cost > alone.cost - trial.fit.cost:
        return None
    gap, cubic = play.against_cubic(free)
    if gap > CUBIC * cubic:
        return None
    return Step(base, trial, ((trial, trial.score(trial.dispersion, base.fit.dof)),))
