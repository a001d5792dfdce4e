"""Forward selection of causes: screened, refitted jointly, ranked with held-out evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from invid.diagnosis.acceptance import (
    drop_insignificant_causes,
    is_accepted,
    is_asked_for,
    least_gain,
    needed_gain,
)
from invid.diagnosis.candidates import (
    REACH,
    is_smaller_model,
    refit_candidates,
    report_candidate,
    rivals_of_best,
    screen_candidates,
)
from invid.diagnosis.context import apply_rule
from invid.diagnosis.evidence import CandidateEvidence, Step, evidence_if_finite, is_at_bound, is_extension_of
from invid.diagnosis.score_test import Score, Screen, terms_to_test
from invid.diagnosis.selection import Selection
from invid.diagnosis.slow_move import SlowMove
from invid.diagnosis.thresholds import FAR, LARGER, LEFT, MOST, NEAR, REACHED, SIGNIFICANCE
from invid.likelihood.candidate_pool import map_candidates
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import JointFit, drop_last_effect, evaluate_held_out, fit, reorder_effects
from invid.likelihood.null_test import null_test
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.likelihood.tempered_fit import fit_tempered
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import SpectralRecord

NONE_YET = "causes of what is missing (none was weighed to the end)"
FURTHER = "further causes"
AGAIN = "each cause once more beside the others"
"""What a search leaves out when its time is spent, as the warning says it."""
HALF = 0.6
"""Share of what is still to be done that is taken to lie ahead after one more cause; for progress alone."""
MODE = 150
"""Iterations for a mode moved to another mass of its axis: it creeps along a valley, and 20 stop halfway."""
NOTHING = Candidate()
AN_AXIS = 8
"""Causes an axis at most besides the friction that the search starts with: no limit that evidence meets (two
of friction, a weight, four faults), and an end where it is misled."""


def select_causes(
    base: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    *,
    linear_axes: bool,
    free: Float64 | None = None,
    start: Float64 | None = None,
    moves: Sequence[SlowMove] = (),
    family: str | None = None,
    friction: Candidate = NOTHING,
) -> Selection:
    """Adds causes while both the training and the held-out gain are significant.

    ``free``: linear parameters of the fit whose time offsets were not bounded; where delays start. ``start``:
    those of the model, tried for a first cause where those of the fit lead nowhere. ``moves``: slow moves
    beside the records, which tell laws of position apart. ``family``: of causes, where only those of one are
    asked for. ``friction``: what the identification fitted along, where the search starts.

    A lag keeps the time offset of its axis beside it: two timings, where a delay is one. Where what the lag's
    model leaves is more than the difference between the two, the data do not ask for the second timing, and
    the delay leads; the lag stays its rival.
    """
    asked = _Asked(linear_axes, free, start, moves, family=family, friction=friction)
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


def _alone(found: Selection, records: Sequence[SpectralRecord]) -> bool:
    """Whether one lag leaves nothing but noise and its delay more: beside others that is the larger model."""
    if len(found.steps) > 1 or found.final.rejects(records):
        return False
    delay = next((t for t, _ in found.steps[0].ranked if t.term.effect.cause == "torque_delay"), None)
    return delay is not None and delay.cost - found.final.cost > found.final.beyond_noise + LARGER


def _named(step: Step) -> tuple[str, Place]:
    return step.chosen.term.effect.cause, step.chosen.term.place


def _is(trial: CandidateEvidence, cause: str, axis: int) -> bool:
    return trial.term.effect.cause == cause and trial.term.place.axis == axis


@dataclass(frozen=True, eq=False)
class _Asked:
    """What a search is given beside the fit and its records; see ``select``."""

    linear_axes: bool
    free: Float64 | None
    start: Float64 | None
    moves: Sequence[SlowMove]
    contested: frozenset[int] = frozenset()
    """Axes on which a delay goes before its lag."""
    axis: int | None = None
    """Where causes are looked for; everywhere where it is none."""
    family: str | None = None
    """Which causes are looked for; all where it is none."""
    friction: Candidate = NOTHING
    """Laws that the identification fitted along: where the search starts."""


def _search(
    base: JointFit, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord], asked: _Asked
) -> Selection:
    """Causes added one by one."""
    start = CandidateEvidence(base, evaluate_held_out(base, held))
    begun = _from_friction(start, train, held, asked)
    if begun is not None and (_right(begun) or budget.is_spent()):
        return begun
    found = _added(Selection(start, start), train, held, asked)
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
    start: CandidateEvidence, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord], asked: _Asked
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
    found: Selection,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    asked: _Asked,
    besides: int = 0,
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
            with budget.use_share(1.0, 1.0 - HALF**number, 1.0 - HALF ** (number + 1)):
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
        return replace(sure, rejected=rejected, cut=found.cut)
    if current.cost > FAR * current.dof:  # what a wrong model leaves, any cause may fit
        small = {_named(s) for s in steps[besides:]}
    return drop_insignificant_causes(
        Selection(start, current, tuple(steps), rejected, found.cut), small, train, held
    )


def _reconsidered(
    found: Selection,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    asked: _Asked,
    *,
    every: int = 0,
) -> Selection:
    """Every cause but the last sought anew beside all others.

    It was chosen while those after it were missing, and may have stood for a part of them: a ripple for
    gravity beside friction, one mass for the next. A mode may be the chain's own, which another cause hid
    from the linear fit.
    """
    known, newest = len(found.base.fit.candidate.terms), len(found.steps) - 1
    for number in reversed(range(len(found.steps))):
        final, at, count = found.final, known + number, known + len(found.steps)
        mode = found.steps[number].chosen.term.effect.cause == "extra_mode"
        if number == newest and not mode and number >= every:
            continue
        last = CandidateEvidence(
            reorder_effects(final.fit, [*range(at), *range(at + 1, count), at]), final.held
        )
        rest = evidence_if_finite(partial(drop_last_effect, last.fit, train), held)
        if rest is None:
            continue
        if mode:
            other = apply_rule("mode-in-chain", last, rest, train, held)
            if other is None and number == newest:
                continue
            rest = other or rest
        rejects = rest.rejects([*train, *held])
        if number == newest and rejects and number >= every:
            continue
        # What stands for a part of another axis' cause leaves the rest of that.
        axis = None if found.final.rejects([*train, *held]) else last.term.place.axis
        here = replace(asked, axis=axis)
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
        chosen = CandidateEvidence(reorder_effects(added[-1].chosen.fit, order), added[-1].chosen.held)
        steps = (*found.steps[:number], *added, *found.steps[number + 1 :])
        found = replace(found, final=chosen, steps=steps)
    return found


def _step(
    current: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    asked: _Asked,
    start: CandidateEvidence,
    *,
    first: bool,
    rejects: bool,
    known: Sequence[CandidateEvidence] = (),
    small: bool = False,
) -> tuple[Step | None, tuple[Score, ...], bool]:
    """The cause that is best beside those of ``current``, what the screen says else, and whether the cause is
    so ``small`` that it counts near the noise only; ``known``: fits that compete as they are."""
    here = current.fit
    terms = [
        t
        for t in terms_to_test(
            here.layout.structure, linear_axes=asked.linear_axes, chosen=here.candidate.terms
        )
        if (t.effect.cause != "torque_delay" or _late(here.layout, here.p, t.place.axis))
        and asked.axis in (None, t.place.axis, t.place.other)
        and asked.family in (None, t.effect.family)
    ]
    count, rows = max(len(terms), 1), here.dof
    trials, scores = _candidates(here, train, held, asked, terms, first=first, rejects=rejects, known=known)
    least_left = min((t.fit.cost for t in trials), default=np.inf)
    trials = [apply_rule("change-retimed", t, train, held) if t.fit.cost <= least_left else t for t in trials]
    trials = apply_rule("gradual-sign", trials, current, train, held)
    trials = [t for t in trials if not is_smaller_model(t)]  # some were larger only for want of rounding
    trials = merge_trials(trials, known)
    if not trials:
        return None, tuple(scores[:5]), False
    trials.sort(key=lambda t: t.score(1.0, rows))
    best = [
        trials[0],
        *(t for t in trials[1:] if t.cost - trials[0].cost < NEAR * (current.cost - trials[0].cost)),
    ]

    def hopeless(t: CandidateEvidence) -> bool:
        # Noise alone has had its best by now: what little more there is makes no cause of it.
        least = needed_gain(current, t, count, rejects=rejects)
        return not rejects and REACH * (current.cost - t.cost) < least

    def polish(t: CandidateEvidence) -> CandidateEvidence:
        if budget.is_spent():
            return t
        report_candidate("fitting", t.term, here, 0.7)
        more = fit(t.fit.layout, train, t.fit.p, t.fit.candidate, iterations=40)
        return CandidateEvidence(more, evaluate_held_out(more, held))

    open_ = [t for t in best[:4] if not t.fit.converged and not hopeless(t)]
    gone_on = iter(map_candidates(polish, open_, here, [*train, *held]))
    # Where the fit went on it may have reached an edge, and then wants something else than this cause.
    polished = [next(gone_on) if t in open_ else t for t in best[:4]]
    if first and not known and all(t.cost > FAR * t.dof for t in polished):
        polished = _tempered(polished, here, train, held)
    polished = [t for t in polished if not is_at_bound(t.fit)]
    trials = polished + [t for t in trials if t not in best[:4]]
    if not trials:
        return None, tuple(scores[:5]), False
    dispersion = min(t.dispersion for t in trials)
    ranked = _ranked([(t, t.score(dispersion, rows)) for t in trials], asked.contested)
    best_of_all = ranked[0][0]
    quiet = not null_test(here.cost, here.dof, train).rejects
    apart = min(t.fit.dispersion for t in trials), min(t.held_dispersion for t in trials)
    there = partial(
        is_accepted, current, best_of_all, apart, count, start, first=first, rejects=rejects, quiet=quiet
    )
    sure = there()
    if not sure and not (small and there(small=True)):
        return None, tuple(scores[:5]), False
    if best_of_all.term.effect.cause == "extra_mode":
        # A mode on one mass is nearly one on the next with another size, and a fit creeps along that.
        others = apply_rule("next-mass", best_of_all, train, held, terms, [best_of_all.term], iterations=MODE)
        trials = merge_trials(trials, others)
    elif best_of_all.rejects([*train, *held]):
        trials += apply_rule("next-mass", best_of_all, train, held, terms, [t.term for t in trials])
    dispersion = min(t.dispersion for t in trials)
    ranked = _ranked([(t, t.score(dispersion, rows)) for t in trials], asked.contested)
    chosen = ranked[0][0]
    sure = sure or current.cost - chosen.cost > MOST * current.excess
    return Step(current, chosen, tuple(ranked)), tuple(scores[:5]), not sure


def _tempered(
    trials: Sequence[CandidateEvidence],
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> list[CandidateEvidence]:
    """The trials, each from where wide valleys lead it if that is lower.

    A strong cause bends the linear fit so far that the way back is uphill under the sensors' noise, for the
    right cause as for the others.
    """

    def temper(t: CandidateEvidence) -> CandidateEvidence:
        if budget.is_spent():
            return t
        report_candidate("fitting", t.term, here, 0.75)
        p = here.p if here.p.size == t.fit.p.size else t.fit.p
        start = here.candidate.plus(t.term, t.x)
        found = evidence_if_finite(partial(fit_tempered, t.fit, train, p, start), held)
        return t if found is None or found.fit.cost > t.fit.cost else found

    return list(map_candidates(temper, trials, here, [*train, *held]))


def _candidates(
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    asked: _Asked,
    terms: Sequence[PlacedEffect],
    *,
    first: bool,
    rejects: bool,
    known: Sequence[CandidateEvidence],
) -> tuple[list[CandidateEvidence], list[Score]]:
    """Joint fits of what the screen promises, and the screen's other answers."""
    scores = screen_candidates(Screen(here), terms)
    late = [t for t in terms if t.effect.cause == "torque_delay"]
    trials = list(apply_rule("delay-beyond-bound", here, train, held, late, asked.free))
    trials += apply_rule("lag-beside-delay", here, train, held, trials, terms)
    tried = {(t.term.effect.cause, t.term.place) for t in trials}
    # Without a shape there is one minimum, and those known are in it.
    tried |= {(t.term.effect.cause, t.term.place) for t in known if not t.term.effect.shapes}
    scores = [
        s
        for s in scores
        if s.term.effect.cause != "torque_delay" and (s.term.effect.cause, s.term.place) not in tried
    ]
    # A rival of those known takes as much.
    known_gain = max((here.cost - t.fit.cost for t in known), default=0.0)

    def least(term: PlacedEffect) -> float:
        return max(least_gain(here, term, len(terms), first=first), known_gain)

    reached = min((t.fit.cost for t in (*trials, *known)), default=np.inf)
    trials += refit_candidates(here, train, held, scores, least, reached)
    trials = merge_trials(trials, rivals_of_best(trials, scores, here, train, held))
    if first and rejects and asked.start is not None and not known:
        trials = apply_rule("start-from-model", trials, asked.start, here, train, held, terms)
    return trials, scores


def merge_trials(
    trials: Sequence[CandidateEvidence], known: Sequence[CandidateEvidence]
) -> list[CandidateEvidence]:
    """Trials and those known; of one cause at one place the better."""
    found = {(t.term.effect.cause, t.term.place): t for t in trials}
    for trial in known:
        key = (trial.term.effect.cause, trial.term.place)
        if key not in found or trial.fit.cost < found[key].fit.cost:
            found[key] = trial
    return list(found.values())


def _ranked(
    scored: Sequence[tuple[CandidateEvidence, float]], contested: frozenset[int]
) -> list[tuple[CandidateEvidence, float]]:
    """Best first; a lag on a contested axis just behind the delay there.

    So is a larger friction model behind a smaller one where the training records do not ask for it: one in 26
    motors with dry friction of 1 N·m alone got a peak of 4.7 ± 9.8 N·m at the slowest for held-out chance. Or
    where it makes those kept out worse: what it then fits is not what the machine does at another amplitude.
    """
    delays = {t.term.place.axis: s for t, s in scored if t.term.effect.cause == "torque_delay"}
    moved = []
    for trial, score in scored:
        behind = trial.term.effect.cause == "torque_lag" and trial.term.place.axis in contested
        least = delays.get(trial.term.place.axis, score) if behind else score
        for smaller, s in scored:
            if not is_extension_of(trial, smaller):
                continue
            limit = LARGER * trial.dispersion
            if smaller.fit.cost - trial.fit.cost < limit or trial.held.cost - smaller.held.cost > limit:
                least, behind = max(least, s), True
        moved.append((trial, max(score, least), behind))
    return [(t, s) for t, s, _ in sorted(moved, key=lambda one: one[1:])]


def _late(layout: Layout, p: Float64, axis: int) -> bool:
    """The time offset stands at one sample: more than sampling convention."""
    return axis in layout.free_delays and abs(layout.delays(p)[axis]) > 0.98 * layout.step
