"""Forward selection of causes: screened, refitted jointly, ranked with held-out evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

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
    refit_candidates,
    report_candidate,
    rivals_of_best,
    screen_candidates,
)
from invid.diagnosis.evidence import CandidateEvidence, Step, evidence_if_finite, is_at_bound, is_extension_of
from invid.diagnosis.rules.asymmetric_pair import doubt_asymmetric_pairs
from invid.diagnosis.rules.known_friction import LEAST_LAWS, add_known_friction
from invid.diagnosis.rules.mode_in_chain import fit_chain_with_mode
from invid.diagnosis.rules.near_variants import (
    delay_variants,
    friction_ladder,
    retime_load_change,
    try_other_places,
)
from invid.diagnosis.rules.slow_moves import rank_by_slow_moves
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

NO_CAUSE_YET = "causes of what is missing (none was weighed to the end)"
FURTHER_CAUSES = "further causes"
OTHER_MASSES = "next mass"
RECONSIDERATION = "each cause once more beside the others"
"""What a search leaves out when its time is spent, in the words of the warning."""
REMAINING_SHARE = 0.6
"""Share of the remaining work that is taken to lie ahead after one more cause; for progress display alone."""
MODE_ITERATIONS = 150
"""Iterations of a mode moved to another mass of its axis: the fit follows a flat valley, 20 stop halfway."""
NO_EFFECTS = Candidate()
MOST_PER_AXIS = 8
"""Most causes of an axis besides the friction that the search starts with. Empirical: real machines need
fewer (two of friction, a weight, four faults); it ends a search that is misled."""


def select_causes(  # noqa: PLR0913 - what is known beside the records
    base: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    *,
    linear_axes: bool,
    free: Float64 | None = None,
    start: Float64 | None = None,
    moves: Sequence[SlowMove] = (),
    family: str | None = None,
    friction: Candidate = NO_EFFECTS,
) -> Selection:
    """Causes added while both the training and the held-out gain are significant.

    ``free`` (n,): parameters of the fit with unbounded time offsets, where delays start. ``start`` (n,):
    parameters of the model, from which known friction is fitted. ``moves``: slow moves beside the records,
    which tell laws of position apart. ``family``: the only family of causes to search. ``friction``: what the
    identification fitted along, where the search starts.

    A lag keeps the time offset of its axis beside it: two timings where a delay is one. Where the excess of
    the lag's model is more than the χ² between the two, the data do not need the second timing, and the delay
    is chosen; the lag stays its rival.
    """
    request = SearchRequest(linear_axes, free, start, moves, family=family, friction=friction)
    found = _search_causes(base, train, held, request)
    contested = frozenset(
        s.chosen.term.place.axis
        for s in found.steps
        if s.chosen.term.effect.cause == "torque_lag"
        and any(_is_cause_on(t, "torque_delay", s.chosen.term.place.axis) for t, _ in s.ranked)
    )
    if not contested or _is_lag_sufficient(found, [*train, *held]):
        return found
    if budget.is_left_out("the delay in place of a lag"):
        return replace(found, is_cut_short=True)
    other = _search_causes(base, train, held, replace(request, contested=contested))
    if any(_is_cause_on(s.chosen, "torque_lag", i) for s in other.steps for i in contested):
        return found  # a delay that needs a lag beside it replaces nothing
    return other if other.final.cost - found.final.cost < found.final.beyond_noise else found


def _is_lag_sufficient(found: Selection, records: Sequence[SpectralRecord]) -> bool:
    """Whether a lag is the only cause, reaches the noise, and is clearly better than a delay.

    Beside other causes the lag is the larger model, and the delay is tried in its place.
    """
    if len(found.steps) > 1 or found.final.rejects(records):
        return False
    delay = next((t for t, _ in found.steps[0].ranked if t.term.effect.cause == "torque_delay"), None)
    return delay is not None and delay.cost - found.final.cost > found.final.beyond_noise + LARGER


def _cause_and_place(step: Step) -> tuple[str, Place]:
    return step.chosen.term.effect.cause, step.chosen.term.place


def _is_cause_on(trial: CandidateEvidence, cause: str, axis: int) -> bool:
    return trial.term.effect.cause == cause and trial.term.place.axis == axis


@dataclass(frozen=True, eq=False)
class SearchRequest:
    """Settings of a search besides the fit and its records; see ``select_causes``."""

    linear_axes: bool
    free: Float64 | None
    start: Float64 | None
    moves: Sequence[SlowMove]
    contested: frozenset[int] = frozenset()
    """Axes on which a delay is preferred to a lag."""
    axis: int | None = None
    """The only axis to search; all where it is ``None``."""
    family: str | None = None
    """The only family of causes to search; all where it is ``None``."""
    friction: Candidate = NO_EFFECTS
    """Laws that the identification fitted along, where the search starts."""


def _search_causes(
    base: JointFit, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord], request: SearchRequest
) -> Selection:
    """The selection of causes added one by one, from the identification's friction or from nothing."""
    start = CandidateEvidence(base, evaluate_held_out(base, held))
    from_friction = _search_from_friction(start, train, held, request)
    if from_friction is not None and (_is_model_right(from_friction) or budget.is_spent()):
        return from_friction
    found = _add_causes(Selection(start, start), train, held, request)
    reconsidered = budget.or_else(
        RECONSIDERATION, partial(_reconsider_causes, found, train, held, request), found
    )
    if [_cause_and_place(s) for s in reconsidered.steps] != [_cause_and_place(s) for s in found.steps]:
        reconsidered = _add_causes(
            reconsidered, train, held, request
        )  # with a cause exchanged there may be more to find
    found = _doubted(reconsidered, train, held)
    found = replace(found, is_cut_short=found.is_cut_short or budget.is_left_out(FURTHER_CAUSES))
    # Friction fitted without a cause that is there may absorb a part of it, so both starts are compared.
    return found if from_friction is None or found.final.cost < from_friction.final.cost else from_friction


def _is_model_right(found: Selection) -> bool:
    """Whether a search ended at a model that counts as right, by the thresholds of ``trust``."""
    final = found.final
    return final.cost <= REACHED * final.dof or final.excess <= LEFT * found.base.excess


def _search_from_friction(
    start: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: SearchRequest,
) -> Selection | None:
    """The search that starts with the friction of the identification; ``None`` where there is none."""
    if len(request.friction.terms) < LEAST_LAWS:
        return None
    known = budget.or_else(
        "known friction",
        partial(add_known_friction, start, request.friction, request.start, train, held),
        None,
    )
    if known is None:
        return None
    names = [_cause_and_place(s) for s in known.steps]
    extended = _add_causes(known, train, held, request, len(names))
    protected = sum(_cause_and_place(s) in names for s in extended.steps)  # they come first
    found = budget.or_else(
        RECONSIDERATION,
        partial(_reconsider_causes, extended, train, held, request, protected=protected),
        extended,
    )
    if [_cause_and_place(s) for s in found.steps] != [_cause_and_place(s) for s in extended.steps]:
        found = _add_causes(
            found, train, held, request, sum(_cause_and_place(s) in names for s in found.steps)
        )
    found = _doubted(found, train, held)
    return replace(found, is_cut_short=found.is_cut_short or budget.is_left_out(FURTHER_CAUSES))


def _doubted(found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]) -> Selection:
    """The selection with pairs that together are friction by direction, where there are two causes."""
    if len(found.steps) < 2:
        return found
    return budget.or_else("asymmetric pair", partial(doubt_asymmetric_pairs, found, train, held), found)


def _settled_steps(
    step: Step, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord], request: SearchRequest
) -> tuple[Step, ...]:
    """The step ranked by the slow moves as well, and friction by direction weighed against its parts."""
    if request.moves:
        step = budget.or_else("slow moves", partial(rank_by_slow_moves, step, request.moves), step)
    if not {"dry", "viscous"} <= set(step.chosen.term.effect.parts):
        return (step,)
    return budget.or_else("friction ladder", partial(friction_ladder, step, train, held), ()) or (step,)


def _add_causes(
    found: Selection,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: SearchRequest,
    known_count: int = 0,
) -> Selection:
    """The selection with causes added one by one; ``known_count``: how many are known and do not count.

    A further cause is compared with the excess without causes, or with the known ones.
    """
    start, current, steps, rejected = found.base, found.final, list(found.steps), found.rejected
    first, sure, small = current if known_count else start, found, set[tuple[str, Place]]()
    most = MOST_PER_AXIS * start.fit.layout.structure.motors + known_count
    while len(steps) < most:
        rejects = current.rejects([*train, *held])
        if steps and not rejects:
            break  # the remainder is noise; what else fits it only shows that the models are imperfect
        number = len(steps)
        try:
            with budget.use_share(1.0, 1.0 - REMAINING_SHARE**number, 1.0 - REMAINING_SHARE ** (number + 1)):
                step, rejected, little = _find_step(
                    current, train, held, request, first, first=not steps, rejects=rejects, small=True
                )
        except budget.BudgetSpent:
            budget.leave_out(f"causes beside {number} found" if number else NO_CAUSE_YET)
            found = replace(found, is_cut_short=True)
            break
        if step is None:
            break
        added = _settled_steps(step, train, held, request)
        steps, current = [*steps, *added], added[-1].chosen
        small |= {_cause_and_place(s) for s in added if little}
        if not small:
            sure = Selection(start, current, tuple(steps), is_cut_short=found.is_cut_short)
    if small and current.cost > FAR * current.dof:
        # Far from the noise a cause that is small beside the first may be an error of the first one's law.
        return replace(sure, rejected=rejected, is_cut_short=found.is_cut_short)
    if current.cost > FAR * current.dof:  # any cause may fit the remainder of a wrong model
        small = {_cause_and_place(s) for s in steps[known_count:]}
    return drop_insignificant_causes(
        Selection(start, current, tuple(steps), rejected, found.is_cut_short), small, train, held
    )


def _reconsider_causes(
    found: Selection,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: SearchRequest,
    *,
    protected: int = 0,
) -> Selection:
    """The selection with every cause but the last searched anew beside all others.

    It was chosen while later ones were missing and may stand for a part of them: a ripple for gravity beside
    friction, one mass for the next. A mode may be the chain's own, which another cause hid from the linear
    fit. ``protected``: the first causes, known beforehand, which are dropped where nothing is found in their
    place.
    """
    known, newest = len(found.base.fit.candidate.terms), len(found.steps) - 1
    for number in reversed(range(len(found.steps))):
        final, at, count = found.final, known + number, known + len(found.steps)
        is_mode = found.steps[number].chosen.term.effect.cause == "extra_mode"
        if number == newest and not is_mode and number >= protected:
            continue
        last = CandidateEvidence(
            reorder_effects(final.fit, [*range(at), *range(at + 1, count), at]), final.held
        )
        rest = evidence_if_finite(partial(drop_last_effect, last.fit, train), held)
        if rest is None:
            continue
        if is_mode:
            inside = partial(fit_chain_with_mode, last, rest, train, held)
            other = budget.or_else("mode in chain", inside, None)
            if other is None and number == newest:
                continue
            rest = other or rest
        rejects = rest.rejects([*train, *held])
        if number == newest and rejects and number >= protected:
            continue
        # At the noise only causes of the same axis can replace it; else it may stand for one of another axis.
        axis = None if found.final.rejects([*train, *held]) else last.term.place.axis
        here = replace(request, axis=axis)
        step, *_ = _find_step(rest, train, held, here, found.base, first=True, rejects=rejects, known=(last,))
        if step is None and number < protected:
            is_viscous_needed = last.term.effect.cause == "viscous_friction" and is_asked_for(rest, last)
            if is_viscous_needed:
                step = Step(rest, last, ((last, last.score(last.dispersion, last.fit.dof)),))
            else:
                found = replace(found, final=rest, steps=(*found.steps[:number], *found.steps[number + 1 :]))
                continue
        if step is None:
            limit = chi2_isf(SIGNIFICANCE, last.term.size) * found.final.dispersion
            if not rejects and rest.cost < found.final.cost + limit:  # not needed beside the others
                found = replace(found, final=rest, steps=(*found.steps[:number], *found.steps[number + 1 :]))
            continue
        added = _settled_steps(step, train, held, request)
        order = [*range(at), *range(count - 1, count - 1 + len(added)), *range(at, count - 1)]
        chosen = CandidateEvidence(reorder_effects(added[-1].chosen.fit, order), added[-1].chosen.held)
        steps = (*found.steps[:number], *added, *found.steps[number + 1 :])
        found = replace(found, final=chosen, steps=steps)
    return found


def _find_step(  # noqa: PLR0913 - what a step is judged by
    current: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: SearchRequest,
    start: CandidateEvidence,
    *,
    first: bool,
    rejects: bool,
    known: Sequence[CandidateEvidence] = (),
    small: bool = False,
) -> tuple[Step | None, tuple[Score, ...], bool]:
    """The step that adds the best cause, the best scores of the screen, and whether it is a small cause.

    The step is ``None`` where no cause is accepted. ``small``: accept causes that count only near the noise;
    ``known``: fits that compete as they are.
    """
    here = current.fit
    terms = [
        t
        for t in terms_to_test(
            here.layout.structure, linear_axes=request.linear_axes, chosen=here.candidate.terms
        )
        if (t.effect.cause != "torque_delay" or _is_offset_at_bound(here.layout, here.p, t.place.axis))
        and request.axis in (None, t.place.axis, t.place.other)
        and request.family in (None, t.effect.family)
    ]
    count, rows = max(len(terms), 1), here.dof
    trials, scores = _fit_candidates(here, train, held, request, terms, first=first, known=known)
    least_left = min((t.fit.cost for t in trials), default=np.inf)
    trials = [
        budget.or_else("change retimed", partial(retime_load_change, t, train, held), t)
        if t.fit.cost <= least_left and t.term.effect.family == "time"
        else t
        for t in trials
    ]
    trials = merge_trials(trials, known)
    if not trials:
        return None, tuple(scores[:5]), False
    trials.sort(key=lambda t: t.score(1.0, rows))
    best = [
        trials[0],
        *(t for t in trials[1:] if t.cost - trials[0].cost < NEAR * (current.cost - trials[0].cost)),
    ]

    def is_hopeless(t: CandidateEvidence) -> bool:
        # Too little gain is left to make a candidate at the noise significant.
        least = needed_gain(current, t, count, rejects=rejects)
        return not rejects and REACH * (current.cost - t.cost) < least

    def continue_fit(t: CandidateEvidence) -> CandidateEvidence:
        if budget.is_spent():
            return t
        report_candidate("fitting", t.term, here, 0.7)
        more = fit(t.fit.layout, train, t.fit.p, t.fit.candidate, iterations=40)
        return CandidateEvidence(more, evaluate_held_out(more, held))

    unconverged = [t for t in best[:4] if not t.fit.converged and not is_hopeless(t)]
    continued = iter(map_candidates(continue_fit, unconverged, here, [*train, *held]))
    # A continued fit may have reached a bound, which calls for another cause.
    polished = [next(continued) if t in unconverged else t for t in best[:4]]
    if first and not known and all(t.cost > FAR * t.dof for t in polished):
        polished = _tempered(polished, here, train, held)
    polished = [t for t in polished if not is_at_bound(t.fit)]
    trials = polished + [t for t in trials if t not in best[:4]]
    if not trials:
        return None, tuple(scores[:5]), False
    dispersion = min(t.dispersion for t in trials)
    ranked = _rank_candidates([(t, t.score(dispersion, rows)) for t in trials], request.contested)
    winner = ranked[0][0]
    train_at_noise = not null_test(here.cost, here.dof, train).rejects
    dispersions = min(t.fit.dispersion for t in trials), min(t.held_dispersion for t in trials)
    accepts = partial(
        is_accepted,
        current,
        winner,
        dispersions,
        count,
        start,
        first=first,
        rejects=rejects,
        quiet=train_at_noise,
    )
    sure = accepts()
    if not sure and not (small and accepts(small=True)):
        return None, tuple(scores[:5]), False
    if winner.term.effect.cause == "extra_mode":
        # A mode on one mass is nearly the same as one on the next with another size.
        elsewhere = partial(
            try_other_places, winner, train, held, terms, [winner.term], iterations=MODE_ITERATIONS
        )
        trials = merge_trials(trials, budget.or_else(OTHER_MASSES, elsewhere, []))
    elif winner.rejects([*train, *held]):
        elsewhere = partial(try_other_places, winner, train, held, terms, [t.term for t in trials])
        trials += budget.or_else(OTHER_MASSES, elsewhere, [])
    dispersion = min(t.dispersion for t in trials)
    ranked = _rank_candidates([(t, t.score(dispersion, rows)) for t in trials], request.contested)
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


def _fit_candidates(  # noqa: PLR0913 - what a step is judged by
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    request: SearchRequest,
    terms: Sequence[PlacedEffect],
    *,
    first: bool,
    known: Sequence[CandidateEvidence],
) -> tuple[list[CandidateEvidence], list[Score]]:
    """Joint fits of the most promising candidates, and the scores of the screen."""
    scores = screen_candidates(Screen(here), terms)
    delays = [t for t in terms if t.effect.cause == "torque_delay"]
    variants = partial(delay_variants, here, train, held, delays, request.free)
    trials: list[CandidateEvidence] = []
    if delays:
        trials = budget.or_else("delay beyond bound", variants, trials)
    tried = {(t.term.effect.cause, t.term.place) for t in trials}
    # An effect without shapes has one minimum, and the known fit is in it.
    tried |= {(t.term.effect.cause, t.term.place) for t in known if not t.term.effect.shapes}
    scores = [
        s
        for s in scores
        if s.term.effect.cause != "torque_delay" and (s.term.effect.cause, s.term.place) not in tried
    ]
    # A rival of the known fits must gain as much as they do.
    known_gain = max((here.cost - t.fit.cost for t in known), default=0.0)

    def least(term: PlacedEffect) -> float:
        return max(least_gain(here, term, len(terms), first=first), known_gain)

    reached = min((t.fit.cost for t in (*trials, *known)), default=np.inf)
    trials += refit_candidates(here, train, held, scores, least, reached)
    trials = merge_trials(trials, rivals_of_best(trials, scores, here, train, held))
    return trials, scores


def merge_trials(
    trials: Sequence[CandidateEvidence], known: Sequence[CandidateEvidence]
) -> list[CandidateEvidence]:
    """Trials and known fits; of one cause at one place the better of the two."""
    found = {(t.term.effect.cause, t.term.place): t for t in trials}
    for trial in known:
        key = (trial.term.effect.cause, trial.term.place)
        if key not in found or trial.fit.cost < found[key].fit.cost:
            found[key] = trial
    return list(found.values())


def _rank_candidates(
    scored: Sequence[tuple[CandidateEvidence, float]], contested: frozenset[int]
) -> list[tuple[CandidateEvidence, float]]:
    """Candidates with their scores, best first.

    A lag on a contested axis is placed just behind the delay there. So is a larger friction model behind a
    smaller one where the training records do not need it (empirical: by held-out chance one in 26 motors with
    dry friction of 1 N·m got a peak of 4.7 ± 9.8 N·m at the slowest), or where it makes held-out records
    worse: it then fits what the machine does not do at another amplitude.
    """
    delays = {t.term.place.axis: s for t, s in scored if t.term.effect.cause == "torque_delay"}
    entries = []
    for trial, score in scored:
        is_behind = trial.term.effect.cause == "torque_lag" and trial.term.place.axis in contested
        least = delays.get(trial.term.place.axis, score) if is_behind else score
        for smaller, s in scored:
            if not is_extension_of(trial, smaller):
                continue
            gained = (smaller.fit.cost - trial.fit.cost) / trial.dispersion
            lost = (trial.held.cost - smaller.held.cost) / trial.dispersion
            if gained < chi2_isf(SIGNIFICANCE, trial.term.size - smaller.term.size) or lost > LARGER:
                least, is_behind = max(least, s), True
        entries.append((trial, max(score, least), is_behind))
    return [(t, s) for t, s, _ in sorted(entries, key=lambda one: one[1:])]


def _is_offset_at_bound(layout: Layout, p: Float64, axis: int) -> bool:
    """Whether the time offset of an axis is at its bound of one sample, more than a sampling convention."""
    return axis in layout.free_delays and abs(layout.delays(p)[axis]) > 0.98 * layout.step
