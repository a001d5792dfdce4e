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
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

POLISHED, REFITTED, PLACES = 12, 6, 2
"""How many candidates are polished and refitted, and at most how many places of one cause."""
NEARLY = 0.5
"""Share of the gain at its cause's best place from which a place is polished as well. A guess: of a mode with
2 % damping, the shape of the grid next to it takes two thirds."""
REACH = 3.0
"""How much more a refit may gain than its screen promised: shapes between the grid's, inner motion. A guess
that saves refits; it only skips what could not be accepted at three times its promise."""
UNEXPLAINED = 1.5
"""χ²/ν above which no candidate explains the records. A guess; it decides only whether to look elsewhere."""


def screen_candidates(screen: Screen, terms: Sequence[PlacedEffect]) -> list[Score]:
    """The likeliest candidates with their best shapes, best first."""

    def look(term: PlacedEffect) -> Score:
        budget.check()
        report_candidate("screening", term, screen.fit, terms.index(term) / (3.0 * len(terms)))
        return screen.best(term)

    def polish(score: Score) -> Score:
        budget.check()
        report_candidate("screening", score.term, screen.fit, 0.35)
        return screen.best(score.term, polish=True)

    scores = map_candidates(look, terms, screen.fit, [])
    scores = [s for s in scores if np.isfinite(s.gain) and s.gain > 0]
    scores.sort(key=lambda s: -s.gain)
    asked = _few_of_a_cause(scores)[:POLISHED]
    # The best may lie between a grid's shapes: a sharp mode, of which the next shape takes two thirds.
    least = {cause: NEARLY * s.gain for s in reversed(scores) if (cause := s.term.effect.cause)}
    further = [s for s in scores if s.term.effect.shapes and s.gain >= least[s.term.effect.cause]]
    asked += [s for s in further if s not in asked and s.gain >= asked[-1].gain]
    polished = map_candidates(polish, asked, screen.fit, [])
    screen.release()
    polished.sort(key=lambda s: -s.gain)
    return _few_of_a_cause(polished)


def _few_of_a_cause(scores: Sequence[Score]) -> list[Score]:
    """At most ``PLACES`` of each cause, in the order given."""
    count: dict[str, int] = {}
    out = []
    for s in scores:
        cause = s.term.effect.cause
        count[cause] = count.get(cause, 0) + 1
        if count[cause] <= PLACES:
            out.append(s)
    return out


def report_candidate(stage: str, term: PlacedEffect, fit: JointFit, fraction: float) -> None:
    """Progress: what is done with a candidate."""
    axis = fit.layout.structure.axes[term.place.axis]
    budget.tell(stage, fraction, axis=axis, cause=term.effect.cause, element=term.place.element)


def no_least_gain(_: PlacedEffect) -> float:
    """No least gain."""
    return 0.0


def refit_candidates(
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    scores: Sequence[Score],
    least: Callable[[PlacedEffect], float],
    reached: float,
) -> list[CandidateEvidence]:
    """Joint fits of the best screened; ``least``: training gain below which a cause is not accepted,
    ``reached``: what others came to."""
    # Far from what the best could reach, or from what would be accepted: no refit.
    far = 0.05 * max((s.gain for s in scores), default=0.0)
    worth = [s for s in scores[:REFITTED] if s.gain >= far and REACH * s.gain >= least(s.term)]

    def begin(score: Score) -> JointFit | None:
        report_candidate("weighing", score.term, here, 0.4 + 0.2 * worth.index(score) / len(worth))
        return fit_if_finite(partial(refit_with_effect, here, train, score.term, score.x, 4, score.shift))

    begun = [f for f in map_candidates(begin, worth, here, train) if f is not None]
    near = min([reached, *(f.cost for f in begun if not is_at_bound(f))])

    def go_on(found: JointFit) -> CandidateEvidence | None:
        # Four steps away from a start that is right to first order: what is far behind stays there.
        if budget.is_spent():
            return CandidateEvidence(found, evaluate_held_out(found, held))
        report_candidate("weighing", found.candidate.terms[-1], here, 0.6)
        if found.converged or found.cost - near >= 0.5 * (here.cost - near):
            return evidence_if_finite(lambda: found, held)
        further = partial(fit, found.layout, train, found.p, found.candidate, known=found.evaluation)
        return evidence_if_finite(partial(further, iterations=10), held)

    trials = map_candidates(go_on, begun, here, [*train, *held])
    return [t for t in trials if t is not None and not is_at_bound(t.fit) and not is_smaller_model(t)]


def add_trials_from_other_start(
    trials: Sequence[CandidateEvidence],
    start: Float64,
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    terms: Sequence[PlacedEffect],
) -> list[CandidateEvidence]:
    """The ``trials`` and, where none of them explains the records, those from other linear parameters.

    A strong cause bends the linear fit without effects so far that no step leads back: friction of a far mass
    takes a spring and a damper apart. The identification fits friction along, so its parameters (``start``)
    may be right where the fit without is not.
    """
    best = min((t.fit.cost for t in trials), default=np.inf)
    if best < UNEXPLAINED * here.dof or here.candidate.terms or start.size != here.p.size:
        return list(trials)
    there = evidence_if_finite(lambda: fit(here.layout, train, start, Candidate(), iterations=0), held)
    if there is None:
        return list(trials)
    scores = [s for s in screen_candidates(Screen(there.fit), terms) if s.term.effect.cause != "torque_delay"]
    others = refit_candidates(there.fit, train, held, scores, no_least_gain, best)
    if not others:
        return list(trials)
    # Where the linear parameters alone gain more than the cause, it is no cause's doing.
    least = min(others, key=lambda t: t.fit.cost).fit
    alone = fit_if_finite(lambda: fit(here.layout, train, least.p, Candidate(), iterations=20))
    if alone is None or here.cost - alone.cost > alone.cost - least.cost:
        return list(trials)
    found = {(t.term.effect.cause, t.term.place): t for t in trials}
    for trial in others:
        key = (trial.term.effect.cause, trial.term.place)
        if trial.fit.cost < (found[key].fit.cost if key in found else here.cost):
            found[key] = trial
    return list(found.values())


def rivals_of_best(
    trials: Sequence[CandidateEvidence],
    scores: Sequence[Score],
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> list[CandidateEvidence]:
    """Candidates that promised as much as the best one and did not get there, from its linear parameters.

    A strong cause bends the linear fit without it. Whichever candidate finds the way back from there would
    stand without the rivals that explain as much and only lost their way.
    """
    plain = [t for t in trials if t.fit.p.size == here.p.size]
    if not plain:
        return []
    best = min(plain, key=lambda t: t.fit.cost)
    gain = {_key(s.term): s.gain for s in scores}
    arrived = {_key(t.term) for t in plain if t.fit.converged or t is best}
    promised = NEARLY * gain.get(_key(best.term), np.inf)
    lost = [s.term for s in scores[:REFITTED] if s.gain >= promised and _key(s.term) not in arrived]
    if not lost:
        return []
    there = fit_if_finite(partial(fit, here.layout, train, best.fit.p, here.candidate, iterations=0))
    if there is None:
        return []
    return refit_candidates(
        there, train, held, screen_candidates(Screen(there), lost), no_least_gain, best.fit.cost
    )


def _key(term: PlacedEffect) -> tuple[str, Place]:
    return term.effect.cause, term.place


def is_smaller_model(trial: CandidateEvidence) -> bool:
    """A larger friction model that is Coulomb or viscous friction to within a tenth.

    Empirical: the motion of inner masses is reconstructed to a few per cent, and so is the law there;
    what a larger model gains by that is no asymmetry and no Stribeck effect.
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
