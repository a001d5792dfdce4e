"""Candidates for one more cause: screened, then refitted jointly with the linear parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from invid.diagnosis.evidence import (
    CandidateEvidence,
    evidence_if_finite,
    fit_if_finite,
    is_at_bound,
    refit_with_effect,
)
from invid.diagnosis.score_test import Score, Screen
from invid.effects.motion import rms
from invid.likelihood.candidate_pool import map_candidates
from invid.likelihood.joint_fit import JointFit, evaluate_held_out, fit
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.signals.spectral_record import SpectralRecord

POLISHED, REFITTED, PLACES = 12, 6, 2
"""How many candidates are polished and refitted, and at most how many places of one cause."""
NEARLY = 0.5
"""Share of the gain at the best place of a cause from which another place is polished as well. Empirical: at
the nearest shape of the grid a mode with 2 % damping shows two thirds of its gain."""
REACH = 3.0
"""Factor by which a refit may gain more than its screen predicted (shapes between the grid's, inner motion).
Empirical; it only skips what could not be accepted at three times its prediction."""


def screen_candidates(screen: Screen, terms: Sequence[PlacedEffect]) -> list[Score]:
    """The likeliest candidates with their best shapes, best first."""

    def screen_term(term: PlacedEffect) -> Score:
        budget.check()
        report_candidate("screening", term, screen.fit, terms.index(term) / (3.0 * len(terms)))
        return screen.best(term)

    def polish_score(score: Score) -> Score:
        budget.check()
        report_candidate("screening", score.term, screen.fit, 0.35)
        return screen.best(score.term, polish=True)

    scores = map_candidates(screen_term, terms, screen.fit, [])
    scores = [s for s in scores if np.isfinite(s.gain) and s.gain > 0]
    scores.sort(key=lambda s: -s.gain)
    to_polish = _best_of_each_cause(scores)[:POLISHED]
    # The best shape may lie between those of the grid, as that of a sharp mode does.
    near_best = {cause: NEARLY * s.gain for s in reversed(scores) if (cause := s.term.effect.cause)}
    further = [s for s in scores if s.term.effect.shapes and s.gain >= near_best[s.term.effect.cause]]
    to_polish += [s for s in further if s not in to_polish and s.gain >= to_polish[-1].gain]
    polished = map_candidates(polish_score, to_polish, screen.fit, [])
    screen.restore_views()
    polished.sort(key=lambda s: -s.gain)
    return _best_of_each_cause(polished)


def _best_of_each_cause(scores: Sequence[Score]) -> list[Score]:
    """The first ``PLACES`` scores of each cause, in the order given."""
    count: dict[str, int] = {}
    out = []
    for s in scores:
        cause = s.term.effect.cause
        count[cause] = count.get(cause, 0) + 1
        if count[cause] <= PLACES:
            out.append(s)
    return out


def report_candidate(stage: str, term: PlacedEffect, fit: JointFit, fraction: float) -> None:
    """Reports progress: stage, axis, cause and element of a candidate."""
    axis = fit.layout.structure.axes[term.place.axis]
    budget.tell(stage, fraction, axis=axis, cause=term.effect.cause, element=term.place.element)


def no_least_gain(_: PlacedEffect) -> float:
    """Zero: every candidate is worth a refit."""
    return 0.0


def refit_candidates(
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    scores: Sequence[Score],
    least: Callable[[PlacedEffect], float],
    reached: float,
) -> list[CandidateEvidence]:
    """Joint fits of the best screened candidates.

    ``least``: gain of training χ² below which a cause is not accepted; ``reached``: lowest χ² of other
    candidates.
    """
    # No refit of what is far behind the best, or could not be accepted.
    least_promise = 0.05 * max((s.gain for s in scores), default=0.0)
    promising = [s for s in scores[:REFITTED] if s.gain >= least_promise and REACH * s.gain >= least(s.term)]

    def start_refit(score: Score) -> JointFit | None:
        report_candidate("weighing", score.term, here, 0.4 + 0.2 * promising.index(score) / len(promising))
        return fit_if_finite(partial(refit_with_effect, here, train, score.term, score.x, 4, score.shift))

    started = [f for f in map_candidates(start_refit, promising, here, train) if f is not None]
    lowest_cost = min([reached, *(f.cost for f in started if not is_at_bound(f))])

    def finish_refit(found: JointFit) -> CandidateEvidence | None:
        # The start is right to first order: what is far behind after four steps stays behind.
        if budget.is_spent():
            return CandidateEvidence(found, evaluate_held_out(found, held))
        report_candidate("weighing", found.candidate.terms[-1], here, 0.6)
        if found.converged or found.cost - lowest_cost >= 0.5 * (here.cost - lowest_cost):
            return evidence_if_finite(lambda: found, held)
        further = partial(fit, found.layout, train, found.p, found.candidate, known=found.evaluation)
        return evidence_if_finite(partial(further, iterations=10), held)

    trials = map_candidates(finish_refit, started, here, [*train, *held])
    return [t for t in trials if t is not None and not is_at_bound(t.fit) and not is_smaller_model(t)]


def rivals_of_best(
    trials: Sequence[CandidateEvidence],
    scores: Sequence[Score],
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> list[CandidateEvidence]:
    """Refits of candidates that the screen ranked as high as the best one, from the best one's linear
    parameters.

    A strong cause biases the linear fit without it. The candidate whose fit leads back from there would else
    have no rivals, although others explain as much and only their fits ended elsewhere.
    """
    comparable = [t for t in trials if t.fit.p.size == here.p.size]
    if not comparable:
        return []
    best = min(comparable, key=lambda t: t.fit.cost)
    gain = {_cause_and_place(s.term): s.gain for s in scores}
    settled = {_cause_and_place(t.term) for t in comparable if t.fit.converged or t is best}
    least_gain = NEARLY * gain.get(_cause_and_place(best.term), np.inf)
    stranded = [
        s.term for s in scores[:REFITTED] if s.gain >= least_gain and _cause_and_place(s.term) not in settled
    ]
    if not stranded:
        return []
    at_best = fit_if_finite(partial(fit, here.layout, train, best.fit.p, here.candidate, iterations=0))
    if at_best is None:
        return []
    return refit_candidates(
        at_best, train, held, screen_candidates(Screen(at_best), stranded), no_least_gain, best.fit.cost
    )


def _cause_and_place(term: PlacedEffect) -> tuple[str, Place]:
    return term.effect.cause, term.place


def is_smaller_model(trial: CandidateEvidence) -> bool:
    """Whether a larger friction model is Coulomb or viscous friction to within a tenth.

    Empirical: the motion of inner masses is reconstructed to a few per cent, and so is the law there; what a
    larger model gains by that is no asymmetry and no Stribeck effect.
    """
    x, cause = trial.x, trial.term.effect.cause
    if cause == "stribeck_friction":
        return float(x[1]) < 0.1 * float(x[0])
    if cause != "asymmetric_friction":
        return False
    pattern = trial.term.place.pattern(trial.fit.layout.structure)
    speed = rms([v.velocity(pattern) for v in trial.fit.evaluation.views])
    up, down, up_rate, down_rate = (abs(float(c)) for c in (x[0], x[1], x[2] * speed, x[3] * speed))
    dry, wet = up + down, up_rate + down_rate
    coulomb = abs(up - down) < 0.1 * dry and wet < 0.1 * dry
    viscous = abs(up_rate - down_rate) < 0.1 * wet and dry < 0.1 * wet
    return coulomb or viscous
