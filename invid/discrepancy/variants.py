"""Near relatives of a candidate that the screen may not offer: each is fitted beside it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from invid.arrays import Float64
from invid.discrepancy.joint import JointFit, fit
from invid.discrepancy.terms import Candidate, Term
from invid.discrepancy.trial import Step, Trial, at_bound, attempted, refit
from invid.discrepancy.words import BY_CAUSE
from invid.effects.sign import DryLaw
from invid.effects.view import Record


def ladder(step: Step, train: Sequence[Record], held: Sequence[Record]) -> tuple[Step, ...]:
    """Friction that differs between the directions against dry and viscous friction at the same place.

    Four parameters against two (Coulomb and viscous), four (Stribeck or presliding, and viscous): each as two
    causes. The cheaper after the penalty is the answer; none where the four parameters are needed.
    """
    place = step.chosen.term.place
    if step.chosen.term.effect.cause != "asymmetric_friction":
        return ()
    x = step.chosen.x
    dry, wet = 0.5 * float(x[0] + x[1]), 0.5 * float(x[2] + x[3])
    views = step.chosen.fit.evaluation.views
    best: tuple[Trial, Trial] | None = None
    here = step.chosen.fit
    rows, dispersion = here.dof, step.chosen.dispersion
    limit = step.chosen.score(dispersion, rows)
    for cause in ("coulomb_friction", "stribeck_friction", "presliding_friction"):
        if dry <= 0 or wet <= 0:
            break
        effect = BY_CAUSE[cause]
        if isinstance(effect, DryLaw) and isinstance(step.chosen.term.effect, DryLaw):
            effect = effect.rounded(step.chosen.term.effect.rounding)
        shape = min((abs(g[0]), g) for g in effect.grid(views, place))[1] if effect.shapes else ()
        start = [dry, 0.2 * dry] if cause == "stribeck_friction" else [dry]
        terms = (Term(effect, place), Term(BY_CAUSE["viscous_friction"], place))
        candidate = Candidate(
            (*here.candidate.terms[:-1], *terms),
            (*here.candidate.x[:-1], np.array([*start, *shape]), np.array([wet])),
        )
        trial = attempted(partial(fit, here.layout, train, here.p, candidate, iterations=20), held)
        if trial is None or trial.score(dispersion, rows) >= limit:
            continue
        both = trial.fit
        alone = Candidate(candidate.terms[:-1], both.candidate.x[:-1])
        one = attempted(partial(fit, here.layout, train, both.p, alone, iterations=12), held)
        if one is not None:
            limit, best = trial.score(dispersion, rows), (one, trial)
    if best is None:
        return ()
    first, second = best
    kept = tuple((t, s) for t, s in step.ranked if t.term.place != place)
    score = second.score(dispersion, rows)
    return (
        Step(step.before, first, ((first, score), *kept)),
        Step(first, second, ((second, score),)),
    )


def elsewhere(
    best: Trial, train: Sequence[Record], held: Sequence[Record], terms: Sequence[Term], tried: Sequence[Term]
) -> list[Trial]:
    """The cause of ``best`` at the places of its axis that were not ``tried``, from its fit.

    The screen's order of places is that of linear parameters which the cause itself has bent; where the best
    leaves more than noise, the next mass may be the one.
    """
    cause, place, here = best.term.effect.cause, best.term.place, best.fit
    known = {t.place for t in tried if t.effect.cause == cause}
    out = []
    for term in terms:
        if term.effect.cause != cause or term.place.axis != place.axis or term.place in known:
            continue
        moved = Term(best.term.effect, term.place)
        candidate = Candidate((*here.candidate.terms[:-1], moved), here.candidate.x)
        trial = attempted(partial(fit, here.layout, train, here.p, candidate, iterations=20), held)
        if trial is not None and not at_bound(trial):
            out.append(trial)
    return out


def delays(
    here: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    terms: Sequence[Term],
    free: Float64 | None,
) -> list[Trial]:
    """Delays of the axes whose time offset stands at its bound, from the fit without that bound."""
    out = []
    for term in terms:
        p = here.p.copy()
        if free is not None and free.size == p.size and not here.candidate.terms:
            p = free.copy()
        known = free if free is not None and free.size == here.p.size else p
        late = float(here.layout.delays(known)[term.place.axis])
        layout, stay = here.layout.without_delay([term.place.axis])
        late -= float(layout.lateness(p[stay], train[0])[term.place.axis])
        candidate = here.candidate.plus(term, np.array([late]))
        trial = attempted(partial(fit, layout, train, p[stay], candidate, iterations=20), held)
        if trial is not None:
            out.append(trial)
    return out


def lags(
    here: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    delays: Sequence[Trial],
    terms: Sequence[Term],
) -> list[Trial]:
    """A lag beside every delay, as late: with another cause still missing the screen may not see it, and
    then the delay would stand without its nearest rival."""
    out = []
    for delay in delays:
        late = abs(float(delay.x[0]))
        for term in terms:
            if term.effect.cause != "torque_lag" or term.place.axis != delay.term.place.axis or not late:
                continue
            trial = attempted(partial(refit, here, train, term, np.array([np.log(late)]), 20), held)
            if trial is not None and not at_bound(trial):
                out.append(trial)
    return out
