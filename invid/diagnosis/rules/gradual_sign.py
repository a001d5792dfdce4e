"""Rule: the range of velocity over which friction changes its sign, found by refits.

A sign that jumps is a limit that no contact reaches. Where the motion is slow beside that range, a jump
leaves a tenth of the friction unexplained, which other causes then fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence, fit_if_finite
from invid.diagnosis.thresholds import CLOSE
from invid.effects.laws.sign import DryLaw
from invid.effects.motion import rms
from invid.likelihood.candidate_pool import map_candidates
from invid.likelihood.joint_fit import JointFit, evaluate_held_out, fit
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.signals.spectral_record import SpectralRecord

SHARES = (0.02, 0.05, 0.12, 0.3)
"""Roundings tried, over the rms velocity. Physical: below the first a jump is as good (1 % of the friction's
power is left); above the last the law is viscous friction that saturates, another cause."""
FINER = (1.6, 1.25)
"""Factors tried around the best rounding, one after the other: a fifth of the width is 1 % of the force."""
ITERATIONS = 6


def fit_gradual_signs(
    trials: Sequence[CandidateEvidence],
    current: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> list[CandidateEvidence]:
    """The trials, with a gradual sign where friction explains half of the excess and ends above the noise."""

    def refine_trial(trial: CandidateEvidence) -> CandidateEvidence | None:
        found = fit_sign_rounding(
            trial.fit,
            train,
            lambda new, old: (old.cost - new.cost) / new.dispersion > np.log(max(new.dof, 2)),
        )
        if found is trial.fit:
            return None
        more = CandidateEvidence(found, evaluate_held_out(found, held))
        return more if more.held.cost < trial.held.cost else None

    is_worth = [t.cost <= 0.5 * current.cost and t.cost >= CLOSE * t.dof for t in trials]
    refined = iter(
        map_candidates(
            refine_trial,
            [t for t, a in zip(trials, is_worth, strict=True) if a],
            current.fit,
            [*train, *held],
        )
    )
    # What a forked helper leaves as it is comes back as a copy: the trial itself stays.
    return [(next(refined) or t) if a else t for t, a in zip(trials, is_worth, strict=True)]


def fit_sign_rounding(
    found: JointFit, records: Sequence[SpectralRecord], better: Callable[[JointFit, JointFit], bool]
) -> JointFit:
    """The fit with the best rounding of its last effect; unchanged where none is ``better(new, old)``.

    A rounding is one parameter more, which it has to earn.
    """
    term = found.candidate.terms[-1]
    law = term.effect
    if not isinstance(law, DryLaw):
        return found
    pattern = term.place.pattern(found.layout.structure)
    speed = rms([v.velocity(pattern) for v in found.evaluation.views])
    best = found
    for share in SHARES:
        trial = _fit_with_law(best, records, term, law.rounded(share * speed))
        if trial is None:
            continue
        if trial.cost < best.cost:
            best = trial
        elif best is not found:
            break
    if best is found:
        return found
    for factor in FINER:
        here = _rounding_of(best)
        for other in (here * factor, here / factor):
            trial = _fit_with_law(best, records, term, law.rounded(other))
            if trial is not None and trial.cost < best.cost:
                best = trial
                break
    return best if better(best, found) else found


def _rounding_of(found: JointFit) -> float:
    law = found.candidate.terms[-1].effect
    return law.rounding if isinstance(law, DryLaw) else 0.0


def _fit_with_law(
    found: JointFit, records: Sequence[SpectralRecord], term: PlacedEffect, law: DryLaw
) -> JointFit | None:
    candidate = Candidate((*found.candidate.terms[:-1], PlacedEffect(law, term.place)), found.candidate.x)
    return fit_if_finite(lambda: fit(found.layout, records, found.p, candidate, iterations=ITERATIONS))
