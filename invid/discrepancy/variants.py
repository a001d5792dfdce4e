"""Near relatives of a candidate that the screen may not offer: each is fitted beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.arrays import Float64
from invid.discrepancy.joint import JointFit, fit, held_out
from invid.discrepancy.plant import Candidate, Term
from invid.discrepancy.trial import HELD_OUT, Step, Trial, at_bound, penalty, refit
from invid.effects import CATALOGUE
from invid.effects.base import Record
from invid.effects.sign import DryLaw


def retimed(
    trial: Trial, train: Sequence[Record], held: Sequence[Record]
) -> tuple[Trial, Sequence[Record], Sequence[Record]]:
    """The other time of doubtful holds (with the command, or half a sample before it) where it fits better.

    Asked after a cause is in place: viscous friction and the half sample are the same data without one.
    """
    doubt = train[0].hold_doubt
    if not doubt.any() or train[0].hold is None:
        return trial, train, held
    step = train[0].step
    late = train[0].hold_offset.copy()
    late[doubt] = np.where(late[doubt] < -0.25 * step, 0.0, -0.5 * step)
    other, other_held = ([replace(r, hold_offset=late) for r in part] for part in (train, held))
    here = trial.fit
    with np.errstate(all="ignore"):
        try:
            found = fit(here.layout, other, here.p, here.candidate, iterations=10)
            there = Trial(found, held_out(found, other_held))
        except np.linalg.LinAlgError:
            return trial, train, held
    # Neither has more parameters; what one must be better by is what noise makes of a choice of two.
    dispersion = max(1.0, there.cost / (found.dof + there.held.dof))
    if there.cost < trial.cost - HELD_OUT * dispersion:
        return there, other, other_held
    return trial, train, held


def ladder(step: Step, train: Sequence[Record], held: Sequence[Record]) -> tuple[Step, ...]:
    """Friction that differs between the directions against dry and viscous friction at the same place.

    Four parameters against two (Coulomb and viscous), four (Stribeck or presliding, and viscous): each as two
    causes. The cheaper after the penalty is the answer; none where the four parameters are needed.
    """
    place = step.chosen.term.place
    if step.chosen.term.effect.cause != "asymmetric_friction":
        return ()
    x = step.chosen.x
    effects = {e.cause: e for e in CATALOGUE}
    dry, wet = 0.5 * float(x[0] + x[1]), 0.5 * float(x[2] + x[3])
    views = step.chosen.fit.evaluation.views
    best: tuple[Trial, Trial] | None = None
    here = step.chosen.fit
    rows, dispersion = here.dof, max(1.0, step.chosen.cost / (here.dof + step.chosen.held.dof))
    limit = step.chosen.cost / dispersion + penalty(step.chosen, rows)
    for cause in ("coulomb_friction", "stribeck_friction", "presliding_friction"):
        if dry <= 0 or wet <= 0:
            break
        effect = effects[cause]
        if isinstance(effect, DryLaw) and isinstance(step.chosen.term.effect, DryLaw):
            effect = effect.rounded(step.chosen.term.effect.rounding)
        shape = min((abs(g[0]), g) for g in effect.grid(views, place))[1] if effect.shapes else ()
        start = [dry, 0.2 * dry] if cause == "stribeck_friction" else [dry]
        terms = (Term(effect, place), Term(effects["viscous_friction"], place))
        candidate = Candidate(
            (*here.candidate.terms[:-1], *terms),
            (*here.candidate.x[:-1], np.array([*start, *shape]), np.array([wet])),
        )
        try:
            both = fit(here.layout, train, here.p, candidate, iterations=20)
            trial = Trial(both, held_out(both, held))
        except np.linalg.LinAlgError:
            continue
        if trial.cost / dispersion + penalty(trial, rows) < limit:
            limit = trial.cost / dispersion + penalty(trial, rows)
            alone = Candidate(candidate.terms[:-1], both.candidate.x[:-1])
            one = fit(here.layout, train, both.p, alone, iterations=12)
            best = Trial(one, held_out(one, held)), trial
    if best is None:
        return ()
    first, second = best
    kept = tuple((t, s) for t, s in step.ranked if t.term.place != place)
    score = second.cost / dispersion + penalty(second, rows)
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
        with np.errstate(all="ignore"):
            try:
                found = fit(
                    layout, train, p[stay], here.candidate.plus(term, np.array([late])), iterations=20
                )
                trial = Trial(found, held_out(found, held))
            except np.linalg.LinAlgError:
                continue
        if np.isfinite(trial.cost):
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
            with np.errstate(all="ignore"):
                try:
                    found = refit(here, train, term, np.array([np.log(late)]), 20)
                    trial = Trial(found, held_out(found, held))
                except np.linalg.LinAlgError:
                    continue
            if np.isfinite(trial.cost) and not at_bound(trial):
                out.append(trial)
    return out
