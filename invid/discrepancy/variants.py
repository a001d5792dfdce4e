"""Near relatives of a candidate that the screen may not offer: each is fitted beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.arrays import Bool, Float64
from invid.discrepancy.joint import JointFit, fit
from invid.discrepancy.missing_torque import null_test
from invid.discrepancy.plant import Candidate, Term
from invid.discrepancy.trial import HELD_OUT, Step, Trial, at_bound, attempted, refit
from invid.discrepancy.words import BY_CAUSE
from invid.effects.base import Record
from invid.effects.sign import DryLaw

Timed = tuple[Trial, Sequence[Record], Sequence[Record]]
"""A trial with the training and held-out records that it was fitted to."""


def retimed(trial: Trial, train: Sequence[Record], held: Sequence[Record]) -> Timed:
    """Doubtful holds at the time between half a sample before the command and with it that fits best.

    Asked after a cause is in place: viscous friction and the half sample are the same data without one. Where
    the cause leaves more than noise every hold is in doubt, as its time was found without the cause.
    """
    here = (trial, train, held)
    if train[0].hold is not None and train[0].command is None and _misses(here):
        train, held = ([replace(r, hold_doubt=_held(r)) for r in part] for part in (train, held))
    best = _best_time(trial, train, held)
    # None has more parameters; what one must be better by is what noise makes of a choice of two.
    if best is None or best[0].cost > trial.cost - HELD_OUT * best[0].dispersion:
        return here
    return best


def timings(start: Trial, train: Sequence[Record], held: Sequence[Record]) -> list[Timed]:
    """Where the search for a first cause starts: holds as they are taken, then, where in doubt, elsewhere.

    At the time that fits best where nothing is missing then; else at the end of their range that they are
    not taken at. Half a sample of a hold is many times the noise where a command is quiet: a cause sought
    with the holds at the wrong time is not found, or another is.
    """
    here = (start, train, held)
    if not _doubtful(train) or not _misses(here):
        return [here]
    best = _best_time(start, train, held)
    if best is not None and not _misses(best):
        return [best]
    late = float(train[0].hold_offset[train[0].hold_doubt][0]) / train[0].step
    further = [t for t in (-0.5, 0.0) if abs(t - late) > 0.25]
    ways = [_at_time(start, train, held, t * train[0].step) for t in further]
    return [here, *(w for w in ways if w is not None)]


def _misses(way: Timed) -> bool:
    """Whether more than noise is left."""
    trial, train, held = way
    return null_test(trial.cost, trial.dof, [*train, *held]).rejects


def _best_time(trial: Trial, train: Sequence[Record], held: Sequence[Record]) -> Timed | None:
    """The same model with the doubtful holds where they fit best; none where there is no doubt.

    A drive whose own loop runs ten times a sample holds 0.45 samples early, and a tenth of that difference
    was seen (χ²/ν of 1.7). χ² is a parabola of the time, so three fits find its foot.
    """
    if not _doubtful(train):
        return None
    step = train[0].step
    times = np.array([-0.5, -0.25, 0.0])
    ways = [w for w in (_at_time(trial, train, held, t * step) for t in times) if w is not None]
    if len(ways) == times.size:
        bend, slope, _ = np.polyfit(times, [w[0].cost for w in ways], 2)
        if bend > 0:
            foot = float(np.clip(-0.5 * slope / bend, -0.55, 0.05))
            last = _at_time(min(ways, key=_cost)[0], train, held, foot * step)
            ways += [] if last is None else [last]
    return min(ways, key=_cost) if ways else None


def _cost(way: Timed) -> float:
    return way[0].cost


def _held(record: Record) -> Bool:
    """(M,) axes whose hold has a law."""
    law: Bool = np.zeros(record.torque.shape[1], dtype=bool)
    if record.hold is not None:
        law = np.abs(record.hold).max(axis=0) > 0
    return law


def retold(trial: Trial, train: Sequence[Record], held: Sequence[Record]) -> Trial | None:
    """The same model fitted to other records; none where nothing finite comes of it."""
    here = trial.fit
    return attempted(lambda: fit(here.layout, train, here.p, here.candidate, iterations=10), held)


def _doubtful(records: Sequence[Record]) -> bool:
    return bool(records[0].hold_doubt.any()) and records[0].hold is not None


def _at_time(trial: Trial, train: Sequence[Record], held: Sequence[Record], time: float) -> Timed | None:
    """The same model fitted with the doubtful holds at ``time`` [s] after the command."""
    late = np.where(train[0].hold_doubt, time, train[0].hold_offset)
    other, other_held = ([replace(r, hold_offset=late) for r in part] for part in (train, held))
    there = retold(trial, other, other_held)
    return None if there is None else (there, other, other_held)


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
