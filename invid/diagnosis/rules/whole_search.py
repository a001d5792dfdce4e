"""Rule: records taken whole, searched beside the friction of every axis.

Every joint has friction. Here that of every motor is in the hypothesis from the start, in one fit, with its
own width of reversal, its rise at slow speed and its asymmetry (``invid.effects.laws.joint``); other causes
are searched in what that leaves. At the end the parts of the friction that are significant are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from invid.diagnosis.candidates import REACH, is_smaller_model, screen_candidates
from invid.diagnosis.evidence import (
    MODES,
    CandidateEvidence,
    Step,
    evidence_if_finite,
    is_at_bound,
    is_size_significant,
    refit_with_effect,
    schwarz_penalty,
)
from invid.diagnosis.rules.friction_parts import friction_parts
from invid.diagnosis.rules.structure_start import starts_beside_friction
from invid.diagnosis.score_test import Score, Screen, terms_to_test
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import FAR, HELD_OUT, MOST, SHARE, SIGNIFICANCE
from invid.effects.laws.joint import JointFriction
from invid.effects.laws.sign import DryLaw
from invid.effects.registry import BY_CAUSE
from invid.likelihood.evaluation import evaluate
from invid.likelihood.joint_fit import JointFit, fit, pack, reorder_effects
from invid.likelihood.nuisance.corner_motion import complete_motion
from invid.likelihood.null_test import null_test
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

LAW, GRAVITY, RIPPLE = JointFriction(), BY_CAUSE["gravity"], BY_CAUSE["cogging"]
MOST_FITS, MOST_TRIED = 3, 5
"""Most candidates of a screen that compete, and most that are fitted to find them (empirical)."""
NEAR_BEST = 0.5
"""Share of the best fit's gain from which a candidate is fitted (empirical)."""
FIRST_MOVES, MOVED, MOVE_ITERATIONS = 4, 2, 12
"""Iterations of a mode that is moved to each other mass beside all other causes, how many of these go on, and
for how many more (empirical)."""
SLOWER = 5.0
"""χ² over the lowest up to which another chain goes on after its first iterations (empirical: a weight that
is found late lowers it a hundred times at once)."""
TIME_TO_FIND = 0.75
"""Share of the time for causes; the rest is for their parts, and for what they may be mistaken for
(empirical)."""
LARGER_FRICTION = ("presliding_friction", "stribeck_friction", "asymmetric_friction")
"""Laws that contain dry or viscous friction: each begins with one of the two, and what more there is of it is
asked once that is found."""
NAMING_ITERATIONS = 10
"""Iterations of a fit with the friction's parts, or without causes: it starts where it ends, almost."""
ROUNDING_ITERATIONS = 4
"""Iterations of a fit with another rounding of dry friction: its size hardly changes (empirical)."""
SHAPES = 7
"""Widths and Stribeck velocities that are tried anew, each (empirical: a factor of three apart)."""
REFINED_BELOW = 0.5
"""Share of χ² below which friction's shapes and the motors' completed motion are found anew (empirical)."""
COARSE_ABOVE = 30.0
"""χ²/ν down to which a search does without the fine grid (``signals.spectral_record``): errors are less."""
SETTLING_ITERATIONS = 10
"""Iterations of the fit with an accepted cause (empirical: most end before)."""
STRUCTURE = ("extra_mode", "coupling_stiffness")
"""Causes that stand for another chain."""
TIMING = ("torque_delay", "torque_lag")
"""Causes that the free time constants and offsets of the drives replace here."""


@dataclass(frozen=True, eq=False)
class BesideFriction:
    """What the search found, and the records that it ended with: near the noise with the motors' motion
    completed (``complete_motion``)."""

    selection: Selection
    train: Sequence[SpectralRecord]
    held: Sequence[SpectralRecord]


def search_beside_friction(  # noqa: PLR0913 - a fit, its records and where they come from
    base: CandidateEvidence,
    known: Candidate,
    start: Float64,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    spectra: Sequence[LineSpectra],
    *,
    linear_axes: bool,
) -> BesideFriction | None:
    """The friction of every motor and further causes; ``None`` where no fit of it is finite.

    ``known``: the friction that the identification found with the linear parameters ``start`` (n,).
    """
    coarse = [r.without_fine_grid() for r in train], [r.without_fine_grid() for r in held]
    null = _fit_with_friction(base, known, start, *coarse)
    if null is None:
        return None
    tell_causes(null)
    found = SearchState(null, (), *coarse, spectra)
    cut = False
    try:
        with budget.use_share(TIME_TO_FIND, 0.1, 0.7):
            found = _with_weights(_from_other_chains(found, linear_axes), linear_axes).settled()
            found = _find_causes(found, (train, held), linear_axes)
            found = _find_with_held_out(found, linear_axes)
    except (_Cut, budget.BudgetSpent) as stopped:
        found, cut = stopped.found if isinstance(stopped, _Cut) else found, True
        budget.leave_out(f"causes beside {len(found.steps)} found and the friction of every motor")
    named = _name_friction(base, null, found, linear_axes)
    return BesideFriction(replace(named, is_cut_short=cut or named.is_cut_short), found.train, found.held)


class _Cut(Exception):
    """The budget ended the search; ``found`` is what it had."""

    def __init__(self, found: SearchState) -> None:
        super().__init__()
        self.found = found


def _find_causes(
    found: SearchState,
    measured: tuple[Sequence[SpectralRecord], Sequence[SpectralRecord]],
    linear_axes: bool,
) -> SearchState:
    """The state with causes added while the training records reject it and one is accepted.

    ``measured``: the records before their motion was completed.

    Raises
    ------
    _Cut
        The budget is spent.
    """
    refined_at, is_fine, is_restarted = np.inf, False, False
    searched_at = np.inf  # χ² at which no cause was found
    while found.rejects():
        here = found.trial.fit
        is_fine = is_fine or here.cost < COARSE_ABOVE * here.dof
        try:
            if is_fine and here.cost < REFINED_BELOW * refined_at:
                found = _refined(found, measured)
                refined_at = found.trial.fit.cost
                if not found.rejects() or refined_at > (1.0 - SHARE) * searched_at:
                    break
            more = _add_cause(found, linear_axes)
            if not is_restarted and (more is None or more.trial.term.effect.cause in STRUCTURE):
                # Another minimum of the chain is excluded before a mode or a spring is believed.
                more, is_restarted = _restarted(found, linear_axes) or more, True
            elif more is not None:
                is_restarted = False
        except budget.BudgetSpent:
            raise _Cut(found) from None
        if more is not None:
            # What is found anew next is fitted to the end there.
            is_next = is_fine and more.trial.fit.cost < REFINED_BELOW * refined_at
            found = more if is_next else more.settled()
            tell_causes(found.trial)
        elif not is_fine or found.trial.fit.cost < (1.0 - SHARE) * refined_at:
            searched_at = found.trial.fit.cost if is_fine else np.inf
            is_fine, refined_at = True, np.inf
        else:
            break
    return found


def _from_other_chains(found: SearchState, linear_axes: bool) -> SearchState:
    """The state from the nearest of the chains that the records lead to, each beside a weight on every axis.

    A weight that turns through radians is a spring to a linear chain, and decides between its minima.
    """
    here = found.trial.fit
    starts = _other_starts(found, linear_axes)
    if not starts:
        return found
    heavy = here.candidate
    for place in () if linear_axes else _end_places(here):
        if not _has_weight(here, place.axis):
            heavy = heavy.plus(PlacedEffect(GRAVITY, place), np.zeros(len(GRAVITY.coefficients)))
    again = partial(_refit, train=found.train, held=found.held, quick=True)
    trials = [again(found.trial, p=p, candidate=heavy, iterations=FIRST_MOVES) for p in (here.p, *starts)]
    near = sorted((t for t in trials if t is not None), key=lambda t: t.cost)
    near = [t for t in near if t.cost < SLOWER * near[0].cost][:MOVED]
    ends = [end for t in near if (end := again(t, iterations=MOVE_ITERATIONS)) is not None]
    best = min(ends, key=lambda t: t.cost, default=None)
    if best is None or (trials[0] is not None and best.cost > (1.0 - SHARE) * trials[0].cost):
        return found
    bare = again(found.trial, p=best.fit.p, iterations=FIRST_MOVES)
    return found if bare is None else replace(found, trial=bare)


def _other_starts(found: SearchState, linear_axes: bool) -> list[Float64]:
    """(n,) parameters with other chains, where the fit is so far from the noise that its own may be wrong."""
    if not found.is_far():
        return []
    return starts_beside_friction(found.trial.fit, found.train, found.spectra, linear_axes=linear_axes)


def _with_weights(found: SearchState, linear_axes: bool) -> SearchState:
    """The state with the weights of all axes that are significant: they are there before any fault.

    In a screen of all causes a ripple of the motor may pass for a weight.
    """
    if linear_axes:
        return found
    for place in _end_places(found.trial.fit):
        here = found.trial.fit
        if budget.is_spent() or not found.rejects():
            break
        if _has_weight(here, place.axis):
            continue
        screen = Screen(here)
        score = screen.best(PlacedEffect(GRAVITY, place), polish=True)
        motor = Place("mass", place.axis, 1)
        ripple = screen.best(PlacedEffect(RIPPLE, motor), polish=True)
        fewest = RIPPLE.limits(screen.views, motor)
        screen.restore_views()
        # Over a small way a part of a ripple passes for a weight; one of the fewest cycles is one itself.
        if ripple.gain > score.gain and ripple.x[-1] > fewest[0][0] + 1e-9:
            continue
        trial = _refit_score(found.trial, score, found.train, found.held)
        if trial is None or here.cost - trial.fit.cost < _least_own_gain(trial.fit):
            continue
        if found.bears_out(trial):
            step = Step(found.trial, trial, ((trial, trial.fit.cost),))
            found = replace(found, trial=trial, steps=(*found.steps, step))
    return found


def _has_weight(here: JointFit, axis: int) -> bool:
    return any(t.effect is GRAVITY and t.place.axis == axis for t in here.candidate.terms)


def _end_places(here: JointFit) -> list[Place]:
    """The place of each axis where a weight hangs."""
    places = GRAVITY.places(here.layout.structure)
    return [next(p for p in places if p.axis == i) for i in range(here.layout.structure.motors)]


def _least_own_gain(here: JointFit) -> float:
    """Least gain of χ² of a cause that is added beside others (three times what Schwarz' criterion asks)."""
    return float(6.0 * np.log(max(here.dof, 2)) * max(here.dispersion, 1.0))


def _restarted(found: SearchState, linear_axes: bool) -> SearchState | None:
    """The state with its chain identified anew beside its friction; ``None`` where it is near the noise or
    that is no nearer.

    The chain was found beside what was missing then, and may lie in another minimum: each is tried.
    """
    here = found.trial.fit
    again = partial(_refit, found.trial, found.train, found.held, iterations=SETTLING_ITERATIONS, quick=True)
    trials = [again(p=p) for p in _other_starts(found, linear_axes)]
    best = min((t for t in trials if t is not None), key=lambda t: t.cost, default=None)
    if best is None or best.fit.cost > (1.0 - SHARE) * here.cost:
        return None
    return replace(found, trial=best)


def _refined(
    found: SearchState,
    measured: tuple[Sequence[SpectralRecord], Sequence[SpectralRecord]],
) -> SearchState:
    """The state with the motors' motion completed by its friction, and friction of the best shapes beside it.

    Both were found beside what was missing until now.
    """
    train, held = (complete_motion(records, found.trial.fit) for records in measured)
    trial = _refit(
        found.trial, train, held, is_last=True, iterations=SETTLING_ITERATIONS, quick=found.is_far()
    )
    if trial is not None:
        found = replace(found, trial=trial, train=train, held=held)
    reshaped = _reshape_friction(found.trial, found.train, found.held)
    return found if reshaped is None else replace(found, trial=reshaped)


def _find_with_held_out(found: SearchState, linear_axes: bool) -> SearchState:
    """The state with the causes that only the records kept out show, in the parameters of the others alone.

    A ripple moves a motor by little where its speed hides it, and by much in another experiment: the training
    is at the noise, and the records kept out are not, whatever the parameters that the training leaves open.
    """
    held = found.held
    if not null_test(_predicted_chi2(found.trial, held), found.trial.held.dof, held).rejects:
        return found
    start = found.fitted_to_all
    if start is None:
        return found
    state = replace(found, trial=start, train=found.every)
    while state.rejects():
        before = state.trial.fit
        more = _add_cause(state, linear_axes)
        if more is None or before.cost - more.trial.fit.cost < MOST * (before.cost - before.dof):
            break  # small beside what is missing: it may be an error of another law
        state = more.settled()
    if len(state.steps) == len(found.steps):
        return found
    trained = _refit(state.trial, found.train, held, is_last=True, iterations=NAMING_ITERATIONS)
    if trained is None or trained.held.cost > found.trial.held.cost:
        return found
    return replace(found, trial=trained, steps=state.steps)


def _reshape_friction(
    trial: CandidateEvidence, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The fit from other widths and Stribeck velocities of a motor's friction; ``None`` where none is better.

    Both are shapes with several minima: what is missing beside them may be their own.
    """
    best: CandidateEvidence | None = None
    for number, term in enumerate(trial.fit.candidate.terms):
        if term.effect is not LAW:
            continue
        start = trial if best is None else best
        here = start.fit
        without = _refit(start, train, held, candidate=here.candidate.without(number), iterations=0)
        if without is None:
            continue
        screen = Screen(without.fit)
        (low, high) = zip(*LAW.limits(screen.views, term.place), strict=True)
        own = screen.score_at_shape(term, here.candidate.x[number][-2:].tolist())[0]
        shapes = [
            (float(v), float(w))
            for v in np.linspace(low[0], high[0], SHAPES)
            for w in np.linspace(low[1], high[1], SHAPES)
        ]
        gain, x = max((screen.score_at_shape(term, s) for s in shapes), key=lambda r: r[0])
        least = chi2_isf(SIGNIFICANCE, len(LAW.shapes)) * here.dispersion
        if gain - own < least:
            continue
        xs = tuple(x if k == number else other for k, other in enumerate(here.candidate.x))
        candidate = Candidate(here.candidate.terms, xs)
        found = _refit(start, train, held, candidate=candidate, iterations=SETTLING_ITERATIONS, quick=True)
        if found is not None and found.fit.cost < here.cost - least:
            best = found
    return best


def tell_causes(found: CandidateEvidence) -> None:
    """Report the causes of a fit while the search goes on."""
    axes = found.fit.layout.structure.axes
    budget.tell_found(
        [
            budget.Found(
                t.effect.cause,
                axes[t.place.axis],
                None if t.place.other < 0 else axes[t.place.other],
                t.place.element,
            )
            for t in found.fit.candidate.terms
        ]
    )


@dataclass(frozen=True, eq=False)
class SearchState:
    """The fit that the search has reached, its steps, the records that it was fitted to and judged on, and
    the ``spectra`` that all of them come from."""

    trial: CandidateEvidence
    steps: tuple[Step, ...]
    train: Sequence[SpectralRecord]
    held: Sequence[SpectralRecord]
    spectra: Sequence[LineSpectra]

    def rejects(self) -> bool:
        """Whether the training records reject the fit."""
        return null_test(self.trial.fit.cost, self.trial.fit.dof, self.train).rejects

    def is_far(self) -> bool:
        """Whether the fit is so far from the noise that its chain may be wrong."""
        return self.trial.fit.cost > FAR * self.trial.fit.dof

    @property
    def every(self) -> list[SpectralRecord]:
        """Training records and those kept out."""
        return [*self.train, *self.held]

    @cached_property
    def fitted_to_all(self) -> CandidateEvidence | None:
        """The fit of all records together; ``None`` where it is not finite."""
        return _refit(self.trial, self.every, self.held, iterations=SETTLING_ITERATIONS, quick=True)

    def bears_out(self, trial: CandidateEvidence) -> bool:
        """Whether the records kept out gain by the cause of a trial, at once or where all are fitted.

        Another pose asks for combinations of parameters that the training leaves open.
        """
        if trial.held.cost <= self.trial.held.cost:
            return True
        without = self.fitted_to_all
        if without is None:
            return False
        candidate = without.fit.candidate.plus(trial.term, trial.x)
        beside = _refit(
            without, self.every, self.held, candidate=candidate, iterations=SETTLING_ITERATIONS, quick=True
        )
        return beside is not None and beside.held.cost < without.held.cost

    def settled(self) -> SearchState:
        """The state with its fit taken to the end: scores mean something at a minimum only.

        Far from the noise without the Jacobian that knows how strong effects change inner motion: what is
        missing bends the fit more.
        """
        here = self.trial.fit
        if here.converged or budget.is_spent():
            return self
        found = _refit(self.trial, self.train, self.held, iterations=SETTLING_ITERATIONS, quick=self.is_far())
        return self if found is None or found.fit.cost > here.cost else replace(self, trial=found)


def _fit_with_friction(
    base: CandidateEvidence,
    known: Candidate,
    start: Float64,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """The fit with the friction of every motor, started from the parameters of the identification."""
    structure = base.fit.layout.structure
    sizes = {(t.effect.cause, t.place): float(x[0]) for t, x in zip(known.terms, known.x, strict=True)}
    candidate = base.fit.candidate
    for axis in range(structure.motors):
        place = Place("mass", axis, 1)
        if any(t.place == place and t.effect.family == "friction" for t in candidate.terms):
            continue
        dry, wet = (sizes.get((c, place), 0.0) for c in ("coulomb_friction", "viscous_friction"))
        (shape,) = LAW.grid(base.fit.evaluation.views, place)
        candidate = candidate.plus(PlacedEffect(LAW, place), np.array([dry, wet, 0.0, 0.0, 0.0, 0.0, *shape]))
    starts = [p for p in (start, base.fit.p) if p.size == base.fit.p.size]
    return _refit(base, train, held, candidate=candidate, p=starts[0], is_last=True, iterations=60)


def _add_cause(found: SearchState, linear_axes: bool) -> SearchState | None:
    """The state with one cause more, the best of a screen and a few fits; ``None`` where none is accepted."""
    current, train, held = found.trial, found.train, found.held
    here, rows = current.fit, current.fit.dof
    chosen = here.candidate.terms
    terms = [
        t
        for t in terms_to_test(here.layout.structure, linear_axes=linear_axes, chosen=chosen)
        if t.effect.cause not in (*TIMING, *LARGER_FRICTION)
        and not (t.effect is GRAVITY and _has_weight(here, t.place.axis))
    ]
    scores = screen_candidates(Screen(here), terms)
    least_gain = chi2_isf(SIGNIFICANCE / len(terms), 1) * min(here.dispersion, 1.0)
    # No refit of what could not be accepted at three times its prediction.
    least_gain = max(least_gain, SHARE * (here.cost - here.dof))
    scores = [s for s in scores if REACH * s.gain >= least_gain and not _is_below_all_lines(s, here)]
    before = _predicted_chi2(current, held)

    def is_accepted(trial: CandidateEvidence) -> bool:
        if is_at_bound(trial.fit) or is_smaller_model(trial):
            return False
        # A mode of no mass may ring on from a record's start: the gain is its ends', a tone's.
        if is_size_significant(trial.fit, len(trial.fit.candidate.terms) - 1) is False:
            return False
        needed = chi2_isf(SIGNIFICANCE / len(terms), max(trial.term.size, 1))
        needed = max(needed, np.log(max(rows, 2)) * trial.term.size) * trial.fit.dispersion
        needed = max(needed, SHARE * (here.cost - here.dof))
        if here.cost - trial.fit.cost < needed:
            return False
        dispersion = max(trial.fit.dispersion, trial.held_dispersion)
        if before - _predicted_chi2(trial, held) < HELD_OUT * dispersion:
            return False
        # A weight that another pose refutes stood for a ripple or a spring to another axis.
        return trial.term.effect is not GRAVITY or found.bears_out(trial)

    trials: list[CandidateEvidence] = []
    reached = 0.0
    for score in _one_weight_an_axis(scores)[:MOST_TRIED]:
        if score.gain < NEAR_BEST * reached or len(trials) == MOST_FITS:
            break
        trial = _refit_score(current, score, train, held)
        if trial is None or not is_accepted(trial):
            continue  # the next in the screen may keep what this one promised
        trials.append(trial)
        reached = max(reached, here.cost - trial.fit.cost)
    if not trials:
        return None
    lowest = min(trials, key=lambda t: t.fit.cost)
    if lowest.term.effect.cause == "extra_mode":
        # A mode on one mass is nearly that on another with another size, on any axis that couples.
        settled = _refit(lowest, train, held, iterations=MOVE_ITERATIONS, quick=True)
        elsewhere = [t for t in terms if t.effect is lowest.term.effect and t.place != lowest.term.place]
        moved = _moved_modes(lowest, len(here.candidate.terms), elsewhere, train, held)
        more = [t for t in (settled, *moved) if t is not None and is_accepted(t)]
        trials = [*(t for t in trials if t is not lowest), *(more or [lowest])]
    least = min(t.dispersion for t in trials)
    # Ranked by the training records; the held-out ones are tested above, parameter uncertainty included.
    ranked = sorted(((t, t.fit.cost / least + schwarz_penalty(t, rows)) for t in trials), key=lambda r: r[1])
    best = ranked[0][0]
    steps = (*found.steps, Step(current, best, tuple(ranked)))
    beside = _independent_causes(best, scores, here)
    together = _fit_together(best, beside, train, held)
    if together is not None:
        steps, best = (*steps, *_joint_steps(best, together)), together
    return replace(found, trial=best, steps=steps)


def _joint_steps(before: CandidateEvidence, together: CandidateEvidence) -> tuple[Step, ...]:
    """A step for each cause of a fit that found them at once."""
    out = []
    for n in range(len(before.fit.candidate.terms), len(together.fit.candidate.terms)):
        one = _move_to_end(together, n)
        out.append(Step(before, one, ((one, one.cost),)))
    return tuple(out)


def _is_below_all_lines(score: Score, here: JointFit) -> bool:
    """Whether a screen puts a mode at the lowest frequency that it may have, where motion drifts."""
    if score.term.effect.cause != "extra_mode":
        return False
    low = score.term.effect.limits(here.evaluation.views, score.term.place)[0][0]
    return bool(score.x[-2] <= low + 1e-9)


def _one_weight_an_axis(scores: Sequence[Score]) -> list[Score]:
    """The scores, best first, with gravity at one place of an axis alone: elsewhere on it it is the same
    cause."""
    out, taken = [], set[int]()
    for s in scores:
        if s.term.effect.cause == "gravity":
            if s.term.place.axis in taken:
                continue
            taken.add(s.term.place.axis)
        out.append(s)
    return out


def _independent_causes(best: CandidateEvidence, scores: Sequence[Score], here: JointFit) -> list[Score]:
    """Weights and ripples of other axes in the same screen; each is read from its own axis' motion alone."""
    least = _least_own_gain(best.fit)
    taken, out = {best.term.place.axis}, []
    for s in scores:
        is_own = s.term.effect.cause in ("cogging", "gravity") and s.term.place.kind == "mass"
        if is_own and s.term.place.axis not in taken and s.gain > least:
            taken.add(s.term.place.axis)
            out.append(s)
    return out


def _fit_together(
    best: CandidateEvidence,
    beside: Sequence[Score],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """The fit with further causes at once, those that are significant; ``None`` where none is."""
    if not beside:
        return None
    candidate = best.fit.candidate
    for s in beside:
        candidate = candidate.plus(s.term, s.x)
    found = _refit(best, train, held, candidate=candidate, iterations=SETTLING_ITERATIONS, quick=True)
    if found is None:
        return None
    first = len(best.fit.candidate.terms)
    sure = [n for n in range(len(beside)) if _wald_ratio(found.fit, first + n) > 1.0]
    if len(sure) < len(beside):
        return _fit_together(best, [beside[n] for n in sure], train, held)
    is_better = found.fit.cost < best.fit.cost and found.held.cost < best.held.cost
    return found if is_better else None


def _refit(  # noqa: PLR0913 - what may differ from the fit that it starts at
    trial: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    *,
    candidate: Candidate | None = None,
    p: Float64 | None = None,
    is_last: bool = False,
    iterations: int,
    quick: bool = False,
) -> CandidateEvidence | None:
    """The fit from where another one ends, with other causes or parameters; ``None`` where it is not finite.

    ``is_last``: however little time is left, for what was found is said.
    """
    here = trial.fit
    own, kept = here.evaluation.views, trial.held.views
    run = partial(
        fit,
        here.layout,
        train,
        here.p if p is None else p,
        here.candidate if candidate is None else candidate,
        iterations=iterations,
        quick=quick,
        near=(*own, *kept)[: len(train)],
    )
    return evidence_if_finite(run, held, kept, always=is_last)


def _refit_score(
    here: CandidateEvidence, score: Score, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The joint fit from a screen's prediction after six iterations; ``None`` where it is not finite."""
    run = partial(refit_with_effect, here.fit, train, score.term, score.x, 6, score.shift)
    return evidence_if_finite(run, held, here.held.views)


def _predicted_chi2(trial: CandidateEvidence, held: Sequence[SpectralRecord]) -> float:
    """χ² of the held-out records with the parameters free within their training uncertainty.

    Records of another kind of motion depend on combinations of parameters that the training hardly
    determines; an error of those is no sign of a wrong law. min over δ of |r + Jδ|² + δᵀC⁻¹δ.
    """
    part = evaluate(trial.fit.layout, held, trial.fit.p, trial.fit.candidate, near=trial.held.views)
    information = trial.fit.evaluation.jacobian
    both = np.concatenate((part.jacobian, information))
    scale = np.linalg.norm(both, axis=0)
    scale[scale == 0] = 1.0
    target = np.concatenate((part.residual, np.zeros(information.shape[0])))
    step, *_ = np.linalg.lstsq(both / scale, target, rcond=1e-10)
    remainder = target - both / scale @ step
    return float(remainder @ remainder)


def _name_friction(
    base: CandidateEvidence,
    null: CandidateEvidence,
    found: SearchState,
    linear_axes: bool,
) -> Selection:
    """The selection with the friction named by its parts, and without causes that are not significant."""
    known = len(base.fit.candidate.terms)
    final, train, held = found.trial, found.train, found.held
    steps = list(found.steps)
    friction: list[tuple[PlacedEffect, Float64]] = []
    motors = [k for k, t in enumerate(final.fit.candidate.terms) if t.effect is LAW]
    for k in motors:
        friction += friction_parts(
            final.fit.candidate.x[k], final.fit.covariance_of(k), final.fit.candidate.terms[k].place
        )
    rest = [k for k in range(known, len(final.fit.candidate.terms)) if k not in motors]
    candidate = final.fit.candidate.only(range(known))
    for term, x in friction:
        candidate = candidate.plus(term, x)
    for k in rest:
        candidate = candidate.plus(final.fit.candidate.terms[k], final.fit.candidate.x[k])
    again = partial(_refit, train=train, held=held, is_last=True, iterations=NAMING_ITERATIONS, quick=True)
    whole = again(final, candidate=candidate)
    if whole is None:
        return Selection(base, base)
    whole = _without_needless_rounding(whole, known, train, held)
    all_steps = [*[Step(base, null, ((null, null.cost),)) for _ in friction], *steps]
    whole, all_steps = _without_weak_causes(whole, known, all_steps, train, held)
    out, cut = dict[int, Step](), False
    # What is lost without each, beside the others.
    losses = [_wald_ratio(whole.fit, known + n) for n in range(len(all_steps))]
    lost = max(sum(x for x in losses if np.isfinite(x)), 1e-300)
    # A wrong chain is the worst of names: a mode or a spring comes first while there is time.
    for n in sorted(
        range(len(all_steps)), key=lambda n: all_steps[n].chosen.term.effect.cause not in STRUCTURE
    ):
        step = all_steps[n]
        if step.chosen is null:
            own = _move_to_end(whole, known + n)
            out[n] = Step(base, own, ((own, own.cost),), losses[n] / lost)
        elif step.chosen.term.effect.family == "position" and step.chosen.term.place.kind == "mass":
            out[n] = step  # a weight or a ripple is read from its own motor's motion
        else:
            try:
                whole, step = _exchange_cause(whole, known + n, step, train, held, linear_axes)
            except budget.BudgetSpent:
                cut = True
            out[n] = step
    if cut:
        budget.leave_out("what the causes found may be mistaken for")
    return Selection(base, whole, tuple(out[n] for n in range(len(all_steps))), is_cut_short=cut)


def _without_weak_causes(
    whole: CandidateEvidence,
    known: int,
    steps: Sequence[Step],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> tuple[CandidateEvidence, list[Step]]:
    """The fit and its steps without the causes, after the ``known`` ones, that are not significant."""
    again = partial(_refit, train=train, held=held, quick=True)
    kept, needed = list(steps), list[Step]()
    while not budget.is_spent():
        sure = [n for n, step in enumerate(kept) if step in needed]
        weak = _weak_causes(whole.fit, known, sure)
        if not weak:
            break
        rest = [n for n in range(len(kept)) if n not in weak]
        fewer = whole.fit.candidate.only([*range(known), *(known + n for n in rest)])
        other = again(whole, candidate=fewer, is_last=True, iterations=NAMING_ITERATIONS)
        if other is None:
            break
        gone = [whole.fit.candidate.terms[known + n] for n in weak]
        least = chi2_isf(SIGNIFICANCE, sum(t.size for t in gone)) * whole.fit.dispersion
        if all(t.effect is GRAVITY for t in gone):
            least = max(least, _least_own_gain(whole.fit))
        if other.fit.cost - whole.fit.cost > least:
            needed += [kept[n] for n in weak]  # strong together with others, whatever its own size
            continue
        whole, kept = other, [kept[n] for n in rest]
    # A gap has no size beside its uncertainty: one that has shrunk to nothing is told by the fit without it.
    for n in reversed(range(len(kept))):
        term = whole.fit.candidate.terms[known + n]
        if term.effect.coefficients or budget.is_spent():
            continue
        other = again(whole, candidate=whole.fit.candidate.without(known + n), iterations=2)
        least = chi2_isf(SIGNIFICANCE, term.size) * whole.fit.dispersion
        if other is not None and other.fit.cost - whole.fit.cost < least:
            whole = other
            del kept[n]
    return whole, kept


def _weak_causes(found: JointFit, known: int, sure: Sequence[int]) -> list[int]:
    """Numbers, after ``known``, of the causes that are not significant beside the others, no ``sure`` one.

    All of them where they are not together either, else the weakest, for each may stand for the next.
    """
    ratios = [_wald_ratio(found, known + n) for n in range(len(found.candidate.terms) - known)]
    # Weights were taken unasked, and are named for what any other cause has to gain.
    least = _least_own_gain(found) / max(found.dispersion, 1.0) / chi2_isf(SIGNIFICANCE, 2)
    ratios = [
        r / least if t.effect is GRAVITY else r
        for r, t in zip(ratios, found.candidate.terms[known:], strict=True)
    ]
    weak = [n for n, ratio in enumerate(ratios) if ratio <= 1.0 and n not in sure]
    if len(weak) < 2 or _wald_ratio(found, *(known + n for n in weak)) <= 1.0:
        return weak
    return [min(weak, key=lambda n: ratios[n])]


def _without_needless_rounding(
    whole: CandidateEvidence,
    known: int,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence:
    """The fit with laws found, after the ``known`` ones, that change their sign at once, but for motors where
    a rounding gains something.

    A sharp law takes the noise of the velocity into account by itself, and a rounding fitted to that would be
    none of the machine's: simulated, it rounds a second time.
    """
    terms = whole.fit.candidate.terms
    sharp = {
        k: PlacedEffect(t.effect.rounded(0.0), t.place)
        for k, t in enumerate(terms)
        if k >= known and isinstance(t.effect, DryLaw) and t.effect.rounding > 0
    }
    penalty = np.log(max(whole.fit.dof, 2)) * whole.fit.dispersion

    def with_roundings(start: CandidateEvidence, kept: Sequence[int]) -> CandidateEvidence | None:
        laws = tuple(t if k in kept else sharp.get(k, t) for k, t in enumerate(terms))
        candidate = Candidate(laws, start.fit.candidate.x)
        again = partial(_refit, start, train, held, is_last=True, iterations=ROUNDING_ITERATIONS)
        return again(candidate=candidate, quick=True)

    # Far from the noise a rounding tells nothing of the machine.
    is_judged = sharp and whole.fit.cost <= FAR * whole.fit.dof
    best = with_roundings(whole, ()) if is_judged else None
    if best is None:
        return whole
    kept: list[int] = []
    for k in sharp:
        # No rounding gains more than all together.
        if budget.is_spent() or best.fit.cost <= whole.fit.cost + penalty:
            break
        other = with_roundings(best, [*kept, k])
        if other is not None and other.fit.cost + penalty < best.fit.cost:
            best, kept = other, [*kept, k]
    return best if best.fit.cost < whole.fit.cost + len(sharp) * penalty else whole


def _move_to_end(trial: CandidateEvidence, at: int) -> CandidateEvidence:
    """The same fit with effect ``at`` moved to the end."""
    count = len(trial.fit.candidate.terms)
    return CandidateEvidence(
        reorder_effects(trial.fit, [*(k for k in range(count) if k != at), at]), trial.held
    )


def _exchange_cause(
    whole: CandidateEvidence,
    at: int,
    step: Step,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    linear_axes: bool,
) -> tuple[CandidateEvidence, Step]:
    """The fit and the step after comparing a cause with those that it is easily mistaken for.

    It was chosen while some of the others were missing.
    """
    budget.check()
    own, here = _move_to_end(whole, at), whole.fit
    # Two iterations: what is left to first order is projected out of the screen.
    rest = _refit(whole, train, held, candidate=here.candidate.without(at), iterations=2, quick=True)
    if rest is None:
        return whole, step
    screen, term = Screen(rest.fit), own.term
    lost_chi2 = float(screen.residual @ screen.residual) - here.cost
    terms = [
        t
        for t in terms_to_test(
            here.layout.structure, linear_axes=linear_axes, chosen=rest.fit.candidate.terms
        )
        if t.effect.cause in (term.effect.cause, *term.effect.looks_like)
        and (t.place.axis == term.place.axis or {t.effect.cause, term.effect.cause} <= set(MODES))
        and (t.effect.cause, t.place) != (term.effect.cause, term.place)
    ]
    is_mode = term.effect.cause == "extra_mode"
    moved = [t for t in terms if is_mode and t.effect.cause == term.effect.cause]
    scores = screen_candidates(screen, [t for t in terms if t not in moved])
    scores = [s for s in scores if s.gain > NEAR_BEST * lost_chi2]
    settled = partial(_settled_rival, own=own, lost_chi2=lost_chi2, train=train, held=held)
    trials = [settled(_refit_score(rest, s, train, held)) for s in scores[:MOST_FITS]]
    # Without it the others have bent to hide it, and the screen's order of its places is theirs.
    trials += _moved_modes(whole, at, moved, train, held)
    possible = [t for t in trials if t is not None and not is_at_bound(t.fit) and not is_smaller_model(t)]
    fits = [own, *possible]
    least, rows = min(t.fit.dispersion for t in fits), here.dof
    ranked = sorted(
        ((t, t.fit.cost / least + schwarz_penalty(t, rows)) for t in fits),
        key=lambda r: (r[1], r[0] is not own),
    )
    best = ranked[0][0]
    if best is not own:
        count = len(best.fit.candidate.terms)
        order = [*range(at), count - 1, *range(at, count - 1)]
        whole = CandidateEvidence(reorder_effects(best.fit, order), best.held)
    return whole, Step(rest, best, tuple(ranked))


def _settled_rival(
    trial: CandidateEvidence | None,
    own: CandidateEvidence,
    lost_chi2: float,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """A rival's fit at its end where it comes near: the other one is at its own."""
    if trial is None or trial.fit.converged or trial.fit.cost - own.fit.cost > (1.0 - NEAR_BEST) * lost_chi2:
        return trial
    again = _refit(trial, train, held, iterations=SETTLING_ITERATIONS, quick=True)
    return trial if again is None or again.fit.cost > trial.fit.cost else again


def _moved_modes(
    whole: CandidateEvidence,
    at: int,
    terms: Sequence[PlacedEffect],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> list[CandidateEvidence]:
    """Fits with mode ``at`` moved to each place of ``terms``; those that are lowest at first go on."""
    candidate = whole.fit.candidate
    here, x = candidate.without(at), candidate.x[at]
    again = partial(_refit, train=train, held=held, quick=True)
    starts = [again(whole, candidate=here.plus(t, x), iterations=FIRST_MOVES) for t in terms]
    near = sorted((t for t in starts if t is not None), key=lambda t: t.fit.cost)[:MOVED]
    return [t for n in near if (t := again(n, iterations=MOVE_ITERATIONS)) is not None]


def _wald_ratio(found: JointFit, *numbers: int) -> float:
    """Wald statistic of the coefficients of effects together over its ``SIGNIFICANCE`` limit; infinite
    without coefficients."""
    terms = found.candidate.terms
    ends = found.layout.count + np.cumsum([t.size for t in terms])
    sizes, shapes = list[int](), list[int]()
    for n in numbers:
        at, count = int(ends[n]) - terms[n].size, len(terms[n].effect.coefficients)
        sizes += range(at, at + count)
        shapes += range(at + count, at + terms[n].size)
    count = len(sizes)
    if not count:
        return np.inf
    rows = [*sizes, *shapes]
    block = found.covariance[np.ix_(rows, rows)]
    if not np.isfinite(block).all():
        block = block[:count, :count]
        if not np.isfinite(block).all():
            return 0.0
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    information = np.linalg.pinv(block / scale[:, None] / scale, hermitian=True)[:count, :count]
    size = pack(found.p, found.candidate)[sizes] / scale[:count]
    return float(size @ information @ size) / chi2_isf(SIGNIFICANCE, count)
