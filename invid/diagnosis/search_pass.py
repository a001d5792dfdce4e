"""One look at a recording through one linear model: fit, and the causes that the records ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from invid.diagnosis.context import apply_rule, current_context
from invid.diagnosis.evidence import CandidateEvidence
from invid.diagnosis.known_effects import fitted_friction
from invid.diagnosis.linear_fit import find_tones, fit_linear_model, refit_without_effects, start_vector
from invid.diagnosis.search import select_causes
from invid.diagnosis.selection import Selection
from invid.diagnosis.slow_move import find_slow_moves
from invid.diagnosis.thresholds import CLOSE, FAR, NAMED_SHARE
from invid.diagnosis.tone import Tone, remove_tones
from invid.diagnosis.validation import (
    PLAIN,
    ValidationRequest,
    is_law_of_motion,
    scatter_of,
    split_records,
    unfolded,
)
from invid.errors import InputError
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import null_test
from invid.likelihood.prepare_records import leave_out_sticking_axes
from invid.model.document import Model
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Recording, Role
from invid.signals.plausibility import check_plausible
from invid.signals.spectra import LineSpectra, all_spectra
from invid.signals.spectral_record import SpectralRecord

WHOLE = "the records taken whole, against the friction of every motor"
"""What a budget that is spent leaves out."""
ALIKE = 5.0
"""How many times as far from its noise as the training records the held-out one may be before it counts as
another machine's: twice the amplitude of an unknown law is four times the power. A guess."""


@dataclass(frozen=True, eq=False)
class SearchPass:
    """The result of one search pass, with the recording and the model that it looked at.

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
    """The linear fit, then causes added while the records ask for them.

    What is kept out may have been measured after a change: the training is free of it, and little or nothing
    there says what it was. Then each record without a role keeps a part of its own out; of records for
    validation, all followed from period to period, the first period joins the training, for causes that
    change with time alone. Or it moves less than the others and shows nothing of what they do, a torque limit
    that it stays below: then it cannot be asked, and a part of each of the others is kept out as well.
    """
    look = _over_periods(recording, model)
    fitted = {r.key for r in look.train} & {s.key for s in look.spectra if s.role is Role.VALIDATE}
    told = [
        f"experiment {key} is for validation, but a period of it was fitted: nothing else shows the machine "
        "on that side of the change; the gain is measured on the rest"
        for key in sorted(fitted)
    ]
    return replace(look, warnings=[*look.warnings, *told])


def _over_periods(recording: Recording, model: Model) -> SearchPass:
    """The look at whole records against every motor's friction, where their periods differ and its laws leave
    a tenth of that scatter at most, or of what the look at their mean leaves; else that look."""
    *_, (folded, _, train, held) = _begun(recording, model, PLAIN)
    scatter = scatter_of(folded, held)
    whole: SearchPass | None = None
    beside_friction = partial(_of_whole, recording, model)
    if scatter and not any(r.alone for r in (*train, *held)):
        with budget.use_share(0.5, 0.05, 0.4):  # the rest is for the other look
            whole = budget.or_else(WHOLE, beside_friction, None)
        if whole is not None and is_law_of_motion(whole.selection.final, scatter):
            return whole
    look = _by_periods(recording, model)
    final = look.selection.final
    if look.tones or final.cost < FAR * final.dof:
        return look
    if whole is None and not scatter:
        whole = budget.or_else(WHOLE, beside_friction, None)
    if whole is None:
        return look
    other = whole.selection.final
    nearer = other.excess / other.dof < (1.0 - NAMED_SHARE) * final.excess / final.dof
    return whole if nearer else look


def _of_whole(recording: Recording, model: Model) -> SearchPass | None:
    """The look at whole records, against the friction of every motor; ``None`` where it finds nothing."""
    current_context().searches += 1
    whole = unfolded(recording)
    spectra, warnings, (base, _, train, held) = _begun(whole, model, ValidationRequest(whole=True))
    selection = apply_rule(
        "whole-records",
        CandidateEvidence(base, evaluate_held_out(base, held)),
        fitted_friction(model, base.layout.structure),
        start_vector(model, base.layout),
        train,
        held,
        linear_axes=recording.linear,
    )
    if selection is None or not selection.steps:
        return None
    return SearchPass(
        whole, model, spectra, (), train, held, refit_without_effects(base, train), selection, warnings
    )


def _by_periods(recording: Recording, model: Model) -> SearchPass:
    """The look at the mean of each record's periods. Where they differ far beyond the sensors' noise, one at
    every period: what repeats in none may have a law that holds in all. What the mean shows beside that is
    measured by what differs, and any cause may pass (presliding friction, of a ripple)."""
    look = _over_changes(recording, model)
    if look.tones or not any(r.differs for r in (*look.train, *look.held)):
        return look
    if budget.is_left_out("every period of the records by itself"):
        return _cut(look)
    other = _looked(look.recording, model, ValidationRequest(each=True))
    return other if other.selection.steps else look


def _over_changes(recording: Recording, model: Model) -> SearchPass:
    look = _looked(recording, model)
    base = look.selection.base
    if look.selection.steps:
        return look
    rejected = null_test(base.held.cost, base.held.dof, look.held).rejects
    changed = rejected or null_test(base.fit.cost, base.fit.dof, look.train).rejects
    if changed and budget.is_left_out("changes between the records and within them"):
        return _cut(look)
    if not rejected and changed:
        other = _looked(recording, model, ValidationRequest(within=True))
        return other if other.selection.steps else look
    if not rejected or base.held.cost / base.held.dof < ALIKE * base.fit.dispersion:
        return look
    if not any(s.role is Role.VALIDATE for s in look.spectra):
        other = _looked(recording, model, ValidationRequest(spare=False))
        return other if other.selection.steps else look
    other = _looked(look.recording, model, ValidationRequest(apart=True))
    return other if _changes(other) else look


def _cut(look: SearchPass) -> SearchPass:
    """The look with a search that the budget ended."""
    return replace(look, selection=replace(look.selection, cut=True))


def _explained_by_a_change(recording: Recording, model: Model) -> bool:
    """Whether a change alone leaves no more than the sensors' noise in every single period of every record.

    What a spring that drifts changes in a light resonance from one period to the next is nearly a sinusoid
    between two lines, and so the same as a tone; of two periods exactly. With that taken out the rest of the
    drift fits no law. A law of one or two numbers that explains all periods is no chance, and a tone is none.
    """
    _, _, (base, free, train, held) = _begun(recording, model, ValidationRequest(apart=True))
    found = select_causes(base, train, held, linear_axes=recording.linear, free=free, family="time")
    return bool(found.steps) and found.final.cost < CLOSE * found.final.dof


def _changes(look: SearchPass) -> bool:
    """Whether a cause was found that changes with time alone."""
    return any(s.chosen.term.effect.family == "time" for s in look.selection.steps)


def _looked(recording: Recording, model: Model, asked: ValidationRequest = PLAIN) -> SearchPass:
    current_context().searches += 1
    begun = partial(_begun, model=model, asked=asked)
    spectra, warnings, (base, free, train, held) = begun(recording)
    tones = [] if asked.each else find_tones(base, held, spectra)
    if tones and not asked.apart and not budget.is_spent() and _explained_by_a_change(recording, model):
        return _looked(recording, model, ValidationRequest(apart=True))
    if tones:
        recording = remove_tones(recording, tones)
        spectra, warnings, (base, free, train, held) = begun(recording)
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
        # A chain that has in it what was found beside.
        base, selection = selection.final.fit, replace(selection, base=selection.final)
    around = apply_rule("load-change", selection, recording, base, search)
    if around is not None:
        base, selection, train, held = around
    bare = refit_without_effects(base, train)
    return SearchPass(recording, model, spectra, tones, train, held, bare, selection, warnings)


_Begun = tuple[JointFit, Float64, list[SpectralRecord], list[SpectralRecord]]


def _begun(
    recording: Recording, model: Model, asked: ValidationRequest
) -> tuple[tuple[LineSpectra, ...], list[str], _Begun]:
    """Spectra, what to warn about, and the linear fit with its records (``fit_linear_model``)."""
    budget.tell("reading spectra", 0.0)
    spectra = all_spectra(recording)
    if not spectra:
        raise InputError(f"{recording.source}: no experiment shakes an axis; nothing to compare with a model")
    check_plausible(recording, spectra)
    train, held, warnings = split_records(recording, spectra, asked)
    train, standing = leave_out_sticking_axes(train, spectra, model, recording)
    held, _ = leave_out_sticking_axes(held, spectra, model, recording)
    warnings = [*(w for s in spectra for w in s.warnings), *warnings, *standing]
    budget.tell("fitting the linear model", 0.05)
    return spectra, warnings, fit_linear_model(model, recording, spectra, train, held, asked)
