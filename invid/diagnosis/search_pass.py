"""One search pass: a recording fitted by one linear model, and the causes that its records need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from invid.diagnosis.evidence import CandidateEvidence
from invid.diagnosis.known_effects import fitted_friction
from invid.diagnosis.linear_fit import (
    find_tones,
    fit_linear_model,
    idle_ground_springs,
    refit_without_effects,
    start_vector,
)
from invid.diagnosis.rules.load_change import search_around_change
from invid.diagnosis.rules.whole_search import search_beside_friction
from invid.diagnosis.search import select_causes
from invid.diagnosis.selection import Selection
from invid.diagnosis.slow_move import find_slow_moves
from invid.diagnosis.thresholds import AT_FLOOR, CLOSE, LEFT, NAMED_SHARE
from invid.diagnosis.tone import Tone, remove_tones
from invid.diagnosis.validation import (
    PLAIN,
    ValidationRequest,
    is_law_of_motion,
    scatter_ratio,
    split_records,
    unfold_periods,
)
from invid.errors import InputError
from invid.identification.ground_springs import SIGNIFICANT
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import null_test
from invid.likelihood.prepare_records import leave_out_sticking_axes
from invid.model.document import Model
from invid.numerics import budget
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Recording, Role
from invid.signals.plausibility import check_plausible
from invid.signals.spectra import LineSpectra, all_spectra
from invid.signals.spectral_record import SpectralRecord

WHOLE_RECORDS = "the records taken whole"
BY_PERIODS = "every cause by itself, and what it may be mistaken for"
"""What a spent budget leaves out, in the words of the warning."""
MOST_WHOLE = 1000
"""Lines of a record, those of all its periods, up to which it is taken whole (empirical: fourteen periods at
once took minutes)."""
TIME_BESIDE_FRICTION = 0.9
"""Share of the search's time for the pass beside the friction of every motor (empirical)."""
TIME_ONE_AXIS = 0.75
"""The same of one axis, where the other pass tells rivals apart (empirical)."""
SAME_MACHINE = 5.0
"""Ratio of held-out and training χ²/ν from which the held-out record counts as another machine's. Empirical:
twice the amplitude of an unknown law is four times the power."""


@dataclass(frozen=True, eq=False)
class SearchPass:
    """The result of one search pass, with the recording and the model that it used.

    ``recording`` is without the ``tones`` that repeat with no period; ``bare`` is the fit of the linear model
    alone, ``selection`` starts from the model with the effects it came with.
    """

    recording: Recording
    model: Model
    spectra: tuple[LineSpectra, ...]
    tones: Sequence[Tone]
    train: Sequence[SpectralRecord]
    held: Sequence[SpectralRecord]
    bare: JointFit
    selection: Selection
    warnings: list[str]


def run_search_pass(recording: Recording, model: Model) -> SearchPass:
    """The linear fit, and the causes added while the records need them.

    A held-out record may have been measured after a change: the training is free of it and says little of
    what changed. Then each record without a role keeps a part of its own out; where records are for
    validation, all are followed from period to period and the first held-out period joins the training, for
    causes that change with time alone. Or it moves less than the others and shows nothing of what they do,
    such as a torque limit that it does not reach: then a part of each of the others is kept out as well.
    """
    result = _off_the_ground(recording, _search_whole_or_periods(recording, model))
    fitted = {r.key for r in result.train} & {s.key for s in result.spectra if s.role is Role.VALIDATE}
    notes = [
        f"experiment {key} is for validation, but a period of it was fitted: nothing else shows the machine "
        "on that side of the change; the gain is measured on the rest"
        for key in sorted(fitted)
    ]
    return replace(result, warnings=[*result.warnings, *notes])


def _off_the_ground(recording: Recording, result: SearchPass) -> SearchPass:
    """The look through the same model without the springs to ground that the causes found have made idle.

    Without a cause a weight that swings looks like such a spring, and the identification may have taken one
    for it. Beside the cause nothing is left of the spring: kept in the fit, it would be a parameter that the
    data do not tell, and blur the cause.
    """
    final = result.selection.final
    idle = idle_ground_springs(final.fit)
    if not idle or not result.selection.steps or budget.is_left_out("the machine without springs to ground"):
        return result
    springs = result.model.chains.ground_springs.copy()
    springs[list(idle)] = 0.0
    other = _search_whole_or_periods(
        recording,
        replace(result.model, chains=replace(result.model.chains, ground_springs=frozen_float(springs))),
    )
    worse = other.selection.final.cost - final.cost
    return other if worse < SIGNIFICANT**2 * len(idle) * max(final.dispersion, 1.0) else result


def _search_whole_or_periods(recording: Recording, model: Model) -> SearchPass:
    """The pass beside the friction of every motor, or the one cause by cause over mean periods.

    The first comes first: every joint has friction, and one fit finds all of it. It takes the records whole
    where periods differ in motion. The second weighs every cause of the catalogue at every place against its
    rivals; it is left out where the first is right on several motors (at the noise, or next to nothing is
    left of what was missing) or was ended by the budget, and else the better one counts.
    """
    spectra, _, (base, _, train, held) = _fit_and_split(recording, model, PLAIN)
    is_short = max(s.periods * r.lines.size for s in spectra for r in train if r.key == s.key) <= MOST_WHOLE
    scatter = scatter_ratio(base, held) if is_short else 0.0
    is_settling = any(r.alone for r in (*train, *held))
    start = CandidateEvidence(base, evaluate_held_out(base, held))
    first: SearchPass | None = None
    if len(model.axes) == 1:
        return _search_one_axis(recording, model, scatter, scatter > 0.0 and not is_settling)
    # Whole, a record that still settles has one pair of ends instead of one for each period.
    is_whole = scatter > 0.0 or (is_settling and is_short)
    if start.rejects([*train, *held]):
        with budget.use_share(TIME_BESIDE_FRICTION, 0.05, 0.6):
            if is_whole and not budget.is_left_out(WHOLE_RECORDS):
                first = _search_beside_friction(recording, model, is_whole=True)
            else:
                first = _search_beside_friction(recording, model, is_whole=False)
    if first is not None:
        final = first.selection.final
        if scatter and is_law_of_motion(final, scatter):
            return first  # no mean period shows what it found
        before = first.selection.base.excess
        is_right = not final.rejects([*first.train, *first.held]) or final.cost < AT_FLOOR * final.dof
        is_right |= final.excess < LEFT * before
        named = {step.chosen.term.place.axis for step in first.selection.steps}
        # What acts on one axis alone is told from its rivals by the other pass.
        if (is_right and len(named) > 1) or budget.is_left_out(BY_PERIODS):
            return first
        if first.selection.is_cut_short:
            budget.leave_out(BY_PERIODS)
            return first
    second = _search_by_periods(recording, model)
    if first is None or second.tones:
        return second
    if not second.selection.steps:
        return first  # what it found is named, with a doubt where it is little
    one, other = (s.selection.final for s in (first, second))
    if second.selection.is_cut_short or budget.is_spent():
        return first if one.excess / one.dof < other.excess / other.dof else second
    # The second has weighed more: the first has to be nearer by far, as between any two laws.
    is_nearer = one.excess / one.dof < (1.0 - NAMED_SHARE) * max(other.excess, other.dof) / other.dof
    return first if is_nearer and other.cost > CLOSE * other.dof else second


def _search_one_axis(recording: Recording, model: Model, scatter: float, is_whole: bool) -> SearchPass:
    """The pass cause by cause over mean periods, or the one beside friction where that is nearer by far.

    A single cause on one axis is told from its rivals by the first; the second supposes friction, and beside
    it another law passes for a mode.
    """
    beside: SearchPass | None = None
    search = partial(_search_beside_friction, recording, model, is_whole=scatter > 0.0)
    if is_whole:
        with budget.use_share(TIME_ONE_AXIS, 0.05, 0.6):  # the rest is for the other pass
            beside = budget.or_else(WHOLE_RECORDS, search, None)
        if beside is not None and is_law_of_motion(beside.selection.final, scatter):
            return beside
    # Where periods differ the pass beside friction may be the better one, even where they drift.
    with budget.use_share(0.5 if scatter and beside is None else 1.0, 0.05, 0.9):
        result = _search_by_periods(recording, model)
    final = result.selection.final
    if result.tones or final.cost < AT_FLOOR * final.dof:
        return result
    if beside is None:
        beside = budget.or_else(WHOLE_RECORDS, search, None)
    if beside is None:
        return result
    if not result.selection.steps:
        return beside
    other = beside.selection.final
    is_nearer = other.excess / other.dof < (1.0 - NAMED_SHARE) * final.excess / final.dof
    return beside if is_nearer else result


def _search_beside_friction(recording: Recording, model: Model, *, is_whole: bool) -> SearchPass | None:
    """The pass beside the friction of every motor, over whole records or the mean of their periods; ``None``
    where it finds nothing."""
    if is_whole:
        recording = unfold_periods(recording)
    request = ValidationRequest(beside_friction=True)
    spectra, warnings, (base, _, train, held) = _fit_and_split(recording, model, request)
    try:
        found = search_beside_friction(
            CandidateEvidence(base, evaluate_held_out(base, held)),
            fitted_friction(model, base.layout.structure),
            start_vector(model, base.layout),
            train,
            held,
            spectra,
            linear_axes=recording.linear,
        )
    except budget.BudgetSpent:
        budget.leave_out(WHOLE_RECORDS)
        return None
    if found is None or not found.selection.steps:
        return None
    selection, train, held = found.selection, [*found.train], [*found.held]
    if selection.final.held.cost >= selection.base.held.cost:
        return None  # worse on the records kept out than without causes
    bare = refit_without_effects(base, train)
    return SearchPass(recording, model, spectra, (), train, held, bare, selection, warnings)


def _search_by_periods(recording: Recording, model: Model) -> SearchPass:
    """The pass over the mean of each record's periods, or over each period where they differ.

    Where periods differ far beyond the sensors' noise, what repeats in none may follow a law that holds in
    all. The scatter hides what the mean shows beside that, and a wrong cause may pass (presliding friction,
    of a ripple).
    """
    result = _search_over_changes(recording, model)
    if result.tones or not any(r.differs for r in (*result.train, *result.held)):
        return result
    if budget.is_left_out("every period of the records by itself"):
        return _mark_cut_short(result)
    other = _search_once(result.recording, model, ValidationRequest(by_period_if_differing=True))
    return other if other.selection.steps else result


def _search_over_changes(recording: Recording, model: Model) -> SearchPass:
    """The pass over mean periods, repeated with other held-out parts where its null test says so.

    Repeated where it finds no cause but the held-out or the training records reject the linear model.
    """
    result = _search_once(recording, model)
    base = result.selection.base
    if result.selection.steps:
        return result
    rejected = null_test(base.held.cost, base.held.dof, result.held).rejects
    changed = rejected or null_test(base.fit.cost, base.fit.dof, result.train).rejects
    if changed and budget.is_left_out("changes between the records and within them"):
        return _mark_cut_short(result)
    if not rejected and changed:
        other = _search_once(recording, model, ValidationRequest(split_every_record=True))
        return other if other.selection.steps else result
    if not rejected or base.held.cost / base.held.dof < SAME_MACHINE * base.fit.dispersion:
        return result
    if not any(s.role is Role.VALIDATE for s in result.spectra):
        other = _search_once(recording, model, ValidationRequest(spare=False))
        return other if other.selection.steps else result
    other = _search_once(result.recording, model, ValidationRequest(by_period=True))
    return other if _has_time_cause(other) else result


def _mark_cut_short(result: SearchPass) -> SearchPass:
    """The pass with its search marked as ended by the budget."""
    return replace(result, selection=replace(result.selection, is_cut_short=True))


def _is_explained_by_change(recording: Recording, model: Model) -> bool:
    """Whether a change over time alone brings every single period of every record to the sensors' noise.

    A spring that drifts changes a light resonance from one period to the next by nearly a sinusoid between
    two lines, which looks like a tone; of two periods exactly. With that removed the rest of the drift fits
    no law. A law of one or two numbers that explains all periods is no chance, and a tone cannot do it.
    """
    _, _, (base, free, train, held) = _fit_and_split(recording, model, ValidationRequest(by_period=True))
    found = select_causes(base, train, held, linear_axes=recording.linear, free=free, family="time")
    return bool(found.steps) and found.final.cost < CLOSE * found.final.dof


def _has_time_cause(result: SearchPass) -> bool:
    """Whether a cause was found that changes with time alone."""
    return any(s.chosen.term.effect.family == "time" for s in result.selection.steps)


def _search_once(recording: Recording, model: Model, request: ValidationRequest = PLAIN) -> SearchPass:
    """One search: linear fit, tones, causes, and a second search without the period of a load change."""
    prepare = partial(_fit_and_split, model=model, request=request)
    spectra, warnings, (base, free, train, held) = prepare(recording)
    tones = [] if request.by_period_if_differing else find_tones(base, held, spectra)
    if (
        tones
        and not request.by_period
        and not budget.is_spent()
        and _is_explained_by_change(recording, model)
    ):
        return _search_once(recording, model, ValidationRequest(by_period=True))
    if tones:
        recording = remove_tones(recording, tones)
        spectra, warnings, (base, free, train, held) = prepare(recording)
    search = partial(
        select_causes,
        linear_axes=recording.linear,
        free=free,
        start=start_vector(model, base.layout),
        moves=find_slow_moves(recording),
        friction=fitted_friction(model, base.layout.structure),
    )
    with budget.use_share(1.0, 0.1, 0.9):
        selection = search(base, train, held)
    if not selection.steps and selection.final.fit is not base:
        # The chain now contains the mode that was found beside it.
        base, selection = selection.final.fit, replace(selection, base=selection.final)
    around = partial(search_around_change, selection, recording, base, search)
    without_change = budget.or_else("load change", around, None) if selection.steps else None
    if without_change is not None:
        base, selection, train, held = without_change
    bare = refit_without_effects(base, train)
    return SearchPass(recording, model, spectra, tones, train, held, bare, selection, warnings)


LinearFit = tuple[JointFit, Float64, list[SpectralRecord], list[SpectralRecord]]


def _fit_and_split(
    recording: Recording, model: Model, request: ValidationRequest
) -> tuple[tuple[LineSpectra, ...], list[str], LinearFit]:
    """Spectra, warnings, and the linear fit with its records (``fit_linear_model``)."""
    budget.tell("reading spectra", 0.0)
    spectra = all_spectra(recording)
    if not spectra:
        raise InputError(f"{recording.source}: no experiment shakes an axis; nothing to compare with a model")
    check_plausible(recording, spectra)
    train, held, warnings = split_records(recording, spectra, request)
    train, standing = leave_out_sticking_axes(train, spectra, model, recording)
    held, _ = leave_out_sticking_axes(held, spectra, model, recording)
    if not request.beside_friction:
        train, held = ([r.without_fine_grid() for r in records] for records in (train, held))
    warnings = [*(w for s in spectra for w in s.warnings), *warnings, *standing]
    budget.tell("fitting the linear model", 0.05)
    return spectra, warnings, fit_linear_model(model, recording, spectra, train, held, request)
