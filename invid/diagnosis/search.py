"""Forward selection of causes: screened, refitted jointly, ranked with held-out evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from invid.diagnosis.acceptance import accepted, is_asked_for, needed_gain, without_untold
from invid.diagnosis.candidates import (
    NOTHING,
    REACH,
    Sought,
    is_smaller_model,
    promised,
    promised_rivals,
    ranked_trials,
    tell_of,
    with_known,
)
from invid.diagnosis.context import apply_rule
from invid.diagnosis.evidence import Step, Trial, at_bound, attempted
from invid.diagnosis.score_test import Score, terms_for
from invid.diagnosis.selection import Selection
from invid.diagnosis.slow_move import Move
from invid.diagnosis.thresholds import FAR, LARGER, LEFT, MOST, REACHED, SIGNIFICANCE
from invid.likelihood.candidate_pool import each
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import JointFit, fit, held_out, reordered, without_last
from invid.likelihood.null_test import null_test
from invid.likelihood.placed_effect import Candidate, Term
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import Record

NONE_YET = "causes of what is missing (none was weighed to the end)"
BESIDE = "relatives of the friction found"
FURTHER = "further causes"
OTHER_MASSES = "the other masses of the axis"
AGAIN = "each cause once more beside the others"
"""What a search leaves out when its time is spent, as the warning says it."""
HALF = 0.6
"""Share of what is still to be done that is taken to lie ahead after one more cause; for progress alone."""
MODE = 150
"""Iterations for a mode moved to another mass of its axis; 20 left it at χ² 2036, 150 at 2003 (830051)."""
AN_AXIS = 8
"""Causes an axis at most besides the friction that the search starts with: no limit that evidence meets (two
of friction, a weight, four faults), and an end where it is misled."""


def select(
    base: JointFit,
    train: Sequence[Record],
    held: Sequence[Record],
    *,
    linear_axes: bool,
    free: Float64 | None = None,
    start: Float64 | None = None,
    moves: Sequence[Move] = (),
    family: str | None = None,
    begun: Sequence[Trial] = (),
    friction: Candidate = NOTHING,
) -> Selection:
    """Adds causes while both the training and the held-out gain are significant.

    ``free``: linear parameters of the fit whose time offsets were not bounded; where delays start. ``start``:
    those of the model, tried for a first cause where those of the fit lead nowhere. ``moves``: slow
    moves beside the records, which tell laws of position apart. ``family``: of
    causes, where only those of one are asked for. ``begun``: what the first cause is chosen from, in place of
    a screen. ``friction``: what the identification fitted along, where the search starts.

    A lag keeps the time offset of its axis beside it: two timings, where a delay is one. Where what the lag's
    model leaves is more than the difference between the two, the data do not ask for the second timing, and
    the delay leads; the lag stays its rival.
    """
    asked = Sought(linear_axes, free, start, moves, family=family, begun=begun, friction=friction)
    found = _search(base, train, held, asked)
    contested = frozenset(
        s.chosen.term.place.axis
        for s in found.steps
        if s.chosen.term.effect.cause == "torque_lag"
        and any(_is(t, "torque_delay", s.chosen.term.place.axis) for t, _ in s.ranked)
    )
    if not contested or _alone(found, [*train, *held]):
        return found
    if budget.is_left_out("the delay in place of a lag"):
        return replace(found, cut=True)
    other = _search(base, train, held, replace(asked, contested=contested))
    if any(_is(s.chosen, "torque_lag", i) for s in other.steps for i in contested):
        return found  # a delay that needs the lag beside it takes nothing's place
    return other if other.final.cost - found.final.cost < found.final.beyond_noise else found


def _alone(found: Selection, records: Sequence[Record]) -> bool:
    """Whether one lag leaves nothing but noise and its delay more: beside others that is the larger model."""
    if len(found.steps) > 1 or found.final.rejects(records):
        return False
    delay = next((t for t, _ in found.steps[0].ranked if t.term.effect.cause == "torque_delay"), None)
    return delay is not None and delay.cost - found.final.cost > found.final.beyond_noise + LARGER


def _named(step: Step) -> tuple[str, Place]:
    return step.chosen.term.effect.cause, step.chosen.term.place


def _is(trial: Trial, cause: str, axis: int) -> bool:
    return trial.term.effect.cause == cause and trial.term.place.axis == axis


def _search(base: JointFit, train: Sequence[Record], held: Sequence[Record], asked: Sought) -> Selection:
    """Causes added one by one."""
    start = Trial(base, held_out(base, held))
    begun = _from_friction(start, train, held, asked)
    if begun is not None and (_right(begun) or budget.spent()):
        return begun
    found = _added(Selection(start, start), train, held, asked)
    found = apply_rule("viscous-with-dry", found, train, held)
    again = budget.or_else(AGAIN, partial(_reconsidered, found, train, held, asked), found)
    if [_named(s) for s in again.steps] != [_named(s) for s in found.steps]:
        again = _added(again, train, held, asked)  # beside another cause there may be more to find
    found = cast(Selection, apply_rule("asymmetric-pair", again, train, held))
    found = replace(found, cut=found.cut or budget.is_left_out(FURTHER))
    # Beside a cause that the identification knew nothing of, its friction may stand for a part of that.
    return found if begun is None or found.final.cost < begun.final.cost else begun


def _right(found: Selection) -> bool:
    """Whether a search ended where a model is taken for right, as ``trust`` has it."""
    final = found.final
    return final.cost <= REACHED * final.dof or final.excess <= LEFT * found.base.excess


def _from_friction(
    start: Trial, train: Sequence[Record], held: Sequence[Record], asked: Sought
) -> Selection | None:
    """The search begun with the friction of the identification; ``None`` where there is none."""
    known = apply_rule("known-friction", start, asked.friction, asked.start, train, held)
    if known is None:
        return None
    names = [_named(s) for s in known.steps]
    begun = _added(known, train, held, asked, len(names))
    every = sum(_named(s) in names for s in begun.steps)  # they stand first
    found = budget.or_else(AGAIN, partial(_reconsidered, begun, train, held, asked, every=every), begun)
    if [_named(s) for s in found.steps] != [_named(s) for s in begun.steps]:
        found = _added(found, train, held, asked, sum(_named(s) in names for s in found.steps))
    found = cast(Selection, apply_rule("asymmetric-pair", found, train, held))
    return replace(found, cut=found.cut or budget.is_left_out(FURTHER))


def _added(
    found: Selection, train: Sequence[Record], held: Sequence[Record], asked: Sought, besides: int = 0
) -> Selection:
    """Causes added one by one to those found; ``besides``: how many of them were known, and do not count.

    A further cause is weighed against what was missing without causes, or with those known.
    """
    found = cast(Selection, apply_rule("reversal-widths", found, train, held))
    start, current, steps, rejected = found.base, found.final, list(found.steps), found.rejected
    first, sure, small = current if besides else start, found, set[tuple[str, Place]]()
    most = AN_AXIS * start.fit.layout.structure.motors + besides
    while len(steps) < most:
        rejects = current.rejects([*train, *held])
        if steps and not rejects:
            break  # what the causes leave is noise; what else fits it says how imperfect their models are
        number = len(steps)
        try:
            with budget.part(1.0, 1.0 - HALF**number, 1.0 - HALF ** (number + 1)):
                step, rejected, little = _step(
                    current, train, held, asked, first, first=not steps, rejects=rejects, small=True
                )
        except budget.BudgetSpent:
            budget.leave_out(f"causes beside {number} found" if number else NONE_YET)
            found = replace(found, cut=True)
            break
        if step is None:
            break
        step = cast(Step, apply_rule("slow-moves", step, asked.moves))
        added = apply_rule("friction-ladder", step, train, held)
        now = Selection(start, added[-1].chosen, (*steps, *added))
        now = cast(Selection, apply_rule("reversal-widths", now, train, held))
        steps, current = list(now.steps), now.final
        small |= {_named(s) for s in added if little}
        if not small:
            sure = replace(now, cut=found.cut)
    if small and current.cost > FAR * current.dof:
        # Far from the noise what is small beside the first cause may be what a law of that errs by.
        return cast(
            Selection, apply_rule("pruning", replace(sure, rejected=rejected, cut=found.cut), train, held)
        )
    if current.cost > FAR * current.dof:  # what a wrong model leaves, any cause may fit
        small = {_named(s) for s in steps[besides:]}
    found = without_untold(Selection(start, current, tuple(steps), rejected, found.cut), small, train, held)
    return cast(Selection, apply_rule("pruning", found, train, held))


def _reconsidered(
    found: Selection,
    train: Sequence[Record],
    held: Sequence[Record],
    asked: Sought,
    *,
    every: int = 0,
) -> Selection:
    """Every cause but the last sought anew beside all others.

    It was chosen while those after it were missing, and may have stood for a part of them: a ripple for
    gravity beside friction, one mass for the next. A mode may be the chain's own, which another cause hid
    from the linear fit. One linear pass says which causes may take its place; only those are refitted.
    """
    known, newest = len(found.base.fit.candidate.terms), len(found.steps) - 1
    for number in reversed(range(len(found.steps))):
        final, at, count = found.final, known + number, known + len(found.steps)
        mode = found.steps[number].chosen.term.effect.cause == "extra_mode"
        if number == newest and not mode and number >= every:
            continue
        last = Trial(reordered(final.fit, [*range(at), *range(at + 1, count), at]), final.held)
        rest = attempted(partial(without_last, last.fit, train), held)
        if rest is None:
            continue
        if mode:
            other = apply_rule("mode-in-chain", last, rest, train, held)
            if other is None and number == newest:
                continue
            rest = other or rest
        rejects = rest.rejects([*train, *held])
        rejected = found.final.rejects([*train, *held])
        if number == newest and rejects and number >= every:
            continue
        # What stands for a part of another axis' cause leaves the rest of that.
        here = replace(asked, axis=None if rejected else last.term.place.axis)
        near = None if mode else promised_rivals(last, train, _terms(last.fit, here, but_last=True))
        if near is not None and not near and _is_there(rest, last, found.base, train, rejects=rejects):
            step: Step | None = Step(rest, last, ((last, last.score(last.dispersion, last.fit.dof)),))
        else:
            here = replace(here, among=None if near is None else frozenset({last.term, *near}))
            step, *_ = _step(rest, train, held, here, found.base, first=True, rejects=rejects, known=(last,))
        if step is None and number < every:
            wet = last.term.effect.cause == "viscous_friction" and is_asked_for(rest, last)
            if wet:
                step = Step(rest, last, ((last, last.score(last.dispersion, last.fit.dof)),))
            else:
                found = replace(found, final=rest, steps=(*found.steps[:number], *found.steps[number + 1 :]))
                continue
        if step is None:
            limit = chi2_isf(SIGNIFICANCE, last.term.size) * found.final.dispersion
            if not rejects and rest.cost < found.final.cost + limit:  # the others leave nothing to it
                found = replace(found, final=rest, steps=(*found.steps[:number], *found.steps[number + 1 :]))
            continue
        step = cast(Step, apply_rule("slow-moves", step, asked.moves))
        added = apply_rule("friction-ladder", step, train, held)
        order = [*range(at), *range(count - 1, count - 1 + len(added)), *range(at, count - 1)]
        chosen = Trial(reordered(added[-1].chosen.fit, order), added[-1].chosen.held)
        steps = (*found.steps[:number], *added, *found.steps[number + 1 :])
        found = replace(found, final=chosen, steps=steps)
    return found


def _terms(here: JointFit, asked: Sought, *, but_last: bool = False) -> list[Term]:
    """What is looked for beside the causes of a fit; ``but_last``: beside all but the last of them."""
    chosen = here.candidate.terms[:-1] if but_last else here.candidate.terms
    return [
        t
        for t in terms_for(here.layout.structure, linear_axes=asked.linear_axes, chosen=chosen)
        if (t.effect.cause != "torque_delay" or _late(here.layout, here.p, t.place.axis))
        and asked.axis in (None, t.place.axis, t.place.other)
        and asked.family in (None, t.effect.family)
    ]


def _is_there(rest: Trial, last: Trial, start: Trial, train: Sequence[Record], *, rejects: bool) -> bool:
    """Whether a cause passes beside all others as a first one does."""
    count = len(terms_for(rest.fit.layout.structure, linear_axes=False))
    quiet = not null_test(rest.fit.cost, rest.fit.dof, train).rejects
    apart = last.fit.dispersion, last.held_dispersion
    return accepted(rest, last, apart, count, start, first=True, rejects=rejects, quiet=quiet)


def _step(
    current: Trial,
    train: Sequence[Record],
    held: Sequence[Record],
    asked: Sought,
    start: Trial,
    *,
    first: bool,
    rejects: bool,
    known: Sequence[Trial] = (),
    small: bool = False,
) -> tuple[Step | None, tuple[Score, ...], bool]:
    """The cause that is best beside those of ``current``, what the screen says else, and whether the cause is
    so ``small`` that it counts near the noise only; ``known``: fits that compete as they are."""
    here = current.fit
    terms = _terms(here, asked)
    count, rows = max(len(terms), 1), here.dof
    if asked.among is not None:
        terms = [t for t in terms if t in asked.among]
    scores: list[Score] = []
    if asked.begun and first and not known:
        trials = list(asked.begun)
    else:
        trials, scores = promised(here, train, held, asked, terms, first=first, rejects=rejects, known=known)
    least_left = min((t.fit.cost for t in trials), default=np.inf)
    trials = [apply_rule("change-retimed", t, train, held) if t.fit.cost <= least_left else t for t in trials]
    trials = apply_rule("gradual-sign", trials, current, train, held)
    trials = [t for t in trials if not is_smaller_model(t)]  # some were larger only for want of rounding
    trials = with_known(trials, known)
    if not trials:
        return None, tuple(scores[:5]), False
    trials.sort(key=lambda t: t.score(1.0, rows))
    best = [
        trials[0],
        *(t for t in trials[1:] if t.cost - trials[0].cost < 0.3 * (current.cost - trials[0].cost)),
    ]

    def hopeless(t: Trial) -> bool:
        # Noise alone has had its best by now: what little more there is makes no cause of it.
        least = needed_gain(current, t, count, rejects=rejects)
        return not rejects and REACH * (current.cost - t.cost) < least

    def polish(t: Trial) -> Trial:
        if budget.spent():
            return t
        tell_of("fitting", t.term, here, 0.7)
        more = fit(t.fit.layout, train, t.fit.p, t.fit.candidate, iterations=40)
        return Trial(more, held_out(more, held))

    open_ = [t for t in best[:4] if not t.fit.converged and not hopeless(t)]
    gone_on = iter(each(polish, open_, here, [*train, *held]))
    # Where the fit went on it may have reached an edge, and then wants something else than this cause.
    polished = [next(gone_on) if t in open_ else t for t in best[:4]]
    polished = [t for t in polished if not at_bound(t.fit)]
    trials = polished + [t for t in trials if t not in best[:4]]
    if not trials:
        return None, tuple(scores[:5]), False
    if trials[0].rejects([*train, *held]):
        trials = with_known(trials, apply_rule("mode-moved", trials, current, train, held, terms))
    dispersion = min(t.dispersion for t in trials)
    ranked = ranked_trials([(t, t.score(dispersion, rows)) for t in trials], asked.contested)
    best_of_all = ranked[0][0]
    quiet = not null_test(here.cost, here.dof, train).rejects
    apart = min(t.fit.dispersion for t in trials), min(t.held_dispersion for t in trials)
    there = partial(
        accepted, current, best_of_all, apart, count, start, first=first, rejects=rejects, quiet=quiet
    )
    sure = there()
    if not sure and not (small and there(small=True)):
        return None, tuple(scores[:5]), False
    if best_of_all.term.effect.cause == "extra_mode":
        # A mode on one mass is nearly one on the next with another size, and a fit creeps along that.
        others = apply_rule("next-mass", best_of_all, train, held, terms, [best_of_all.term], iterations=MODE)
        trials = with_known(trials, others)
    elif best_of_all.rejects([*train, *held]):
        trials += apply_rule("next-mass", best_of_all, train, held, terms, [t.term for t in trials])
    dispersion = min(t.dispersion for t in trials)
    ranked = ranked_trials([(t, t.score(dispersion, rows)) for t in trials], asked.contested)
    chosen = ranked[0][0]
    sure = sure or current.cost - chosen.cost > MOST * current.excess
    return Step(current, chosen, tuple(ranked)), tuple(scores[:5]), not sure


def _late(layout: Layout, p: Float64, axis: int) -> bool:
    """The time offset stands at one sample: more than sampling convention."""
    return axis in layout.free_delays and abs(layout.delays(p)[axis]) > 0.98 * layout.step
