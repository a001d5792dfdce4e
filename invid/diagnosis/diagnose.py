"""The diagnosis of a recording: fit, test, select, judge, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from invid.diagnosis.consequence import grade_consequences
from invid.diagnosis.context import apply_rule, current_context, use_context
from invid.diagnosis.known_effects import merge_spring_damping
from invid.diagnosis.outcome import limit_unfinished_search
from invid.diagnosis.rigid import diagnose_trajectory
from invid.diagnosis.rules.dropped_rows import (
    add_dropped_rows_finding,
    interpolate_dropped_rows,
    rms_before_repair,
)
from invid.diagnosis.search_pass import run_search_pass
from invid.diagnosis.time_domain_check import REFUSED, Replay, add_time_domain_check, simulate_held_out
from invid.diagnosis.verdict import build_diagnosis, extended_model
from invid.effects.units import unit_of
from invid.errors import InputError, NotIdentifiableError
from invid.identification.identify import identify_chains
from invid.identification.machine_kind import is_of_rigid_axes, machine_kind
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.null_test import null_test
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.model.document import Model, model_to_json
from invid.numerics import budget
from invid.recording.model import Recording
from invid.signals.encoder_glitches import remove_glitches
from invid.signals.plausibility import check_units

CLEARLY = 0.1
"""Share of a hold from which it is worth a word that it acts inside the drive."""

TIME_TO_IDENTIFY, TIME_TO_SEARCH = 0.5, 0.85
"""Share of a budget for the identification, and of the rest for the search; what remains is for the
simulation over time and for what is said. A guess."""

OF_GIVEN = "the model given, of its own recording: "
"""Before what the identification of a model warned of that was drawn from other data."""


def diagnose(
    recording: Recording,
    *,
    model: Model | None = None,
    masses: Sequence[int] | Literal["auto"] | None = None,
) -> Diagnosis:
    """What the simulation gets wrong, the cause, the extended model and the gain.

    Parameters
    ----------
    model
        Start of the linear parameters; identified from the recording where not given.
    masses
        Masses of each axis for that identification; see ``invid.identification.identify.identify``.

    Raises
    ------
    InputError, NotIdentifiableError
        Data from which no model can be drawn, or a model that does not fit the recording's axes.
    """
    recording, told = remove_glitches(recording)
    # What a search tries far from the solution may overflow; it is told by its size and taken back.
    with use_context(current_context().fresh()) as context, np.errstate(all="ignore"):
        try:
            result = _diagnosed(recording, model, masses)
        except np.linalg.LinAlgError as error:
            raise NotIdentifiableError(
                f"{recording.source}: the model is so far from these records that no fit of both is finite "
                f"({error}); give the model of this robot, or diagnose without one"
            ) from None
        result = replace(result, details={**result.details, "rules": context.fired()})
    cut = budget.warning()
    if cut is not None:
        kept = [w for w in result.warnings if not w.startswith(budget.SPENT)]
        result = replace(result, warnings=(*kept, cut))
    if told:
        result = replace(result, warnings=tuple(dict.fromkeys([*result.warnings, *told])))
    return grade_consequences(result, recording)


def _diagnosed(
    recording: Recording, model: Model | None, masses: Sequence[int] | Literal["auto"] | None
) -> Diagnosis:
    """The diagnosis of a recording without glitches."""
    if model is not None and is_of_rigid_axes(model, recording):
        return diagnose_trajectory(recording, model=model)
    dropped = apply_rule("dropped-rows", recording)
    sound = interpolate_dropped_rows(recording, dropped) if dropped else recording
    if model is None:
        with budget.use_share(TIME_TO_IDENTIFY, 0.0, 0.3):
            kind = machine_kind(recording, masses, lambda: identify_chains(sound, masses))
            model = kind.model
            if model is None and not kind.rigid:
                model = identify_chains(sound, masses)
        if model is None:
            result = diagnose_trajectory(recording, analysis=kind.analysis)
            return replace(result, warnings=(*result.warnings, kind.said)) if kind.said else result
    elif model.provenance.get("recorded") != recording.created:
        said = (w.removeprefix(OF_GIVEN) for w in model.warnings)
        model = replace(model, warnings=tuple(f"{OF_GIVEN}{w}" for w in said))
    if model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    check_units(model, recording)
    with budget.use_share(TIME_TO_SEARCH, 0.3, 0.9):
        look = run_search_pass(sound, merge_spring_damping(model))
    sound, model, tones, bare = look.recording, look.model, look.tones, look.bare
    train, held = look.train, look.held
    selection = look.selection.as_far_as_explained()
    warnings = [*look.warnings, *hold_timing_warnings(selection.final.fit, recording)]
    result = build_diagnosis(sound, model, selection, bare, train, held, tones, warnings)
    if result.verdict is Verdict.UNEXPLAINED and selection.steps:
        alone = apply_rule("own-evidence", selection, train, held)
        if alone is not None:
            selection = alone.as_far_as_explained()
            result = build_diagnosis(sound, model, selection, bare, train, held, tones, warnings)
    budget.tell("simulating over time", 0.92)
    if result.findings and not budget.is_left_out("the extended model simulated over time"):
        linear = extended_model(model, bare, ())
        answer = simulate_held_out(sound, look.spectra, linear, result.model, selection.final.fit, held)
        reached = not null_test(selection.final.held.cost, selection.final.held.dof, held).rejects
        lost = isinstance(answer, Replay) and answer.lost and reached
        if isinstance(answer, Replay) and answer.refused and not lost:
            result = build_diagnosis(
                sound, model, selection, bare, train, held, tones, [*warnings, REFUSED], refused=True
            )
        elif isinstance(answer, Replay) and not lost:
            selection = selection.wider(answer.shift)
            result = build_diagnosis(sound, model, selection, bare, train, held, tones, warnings)
        result = add_time_domain_check(result, answer, sound, lost=lost)
        result = replace(result, details={**result.details, "linear_model": model_to_json(linear)})
    if selection.cut:
        result = limit_unfinished_search(result)
    return add_dropped_rows_finding(
        result, recording, dropped, rms_before_repair(recording, bare) if dropped else {}
    )


def hold_timing_warnings(final: JointFit, recording: Recording) -> list[str]:
    """Warnings about holds that no record shows alone and that were not taken to act with the command."""
    layout, said = final.layout, []
    for hold, share in zip(layout.holds, final.p[layout.holds_at], strict=True):
        friction = 0.5 * layout.step * float(share) * hold.stiffness
        if hold.damping or share < CLEARLY:
            continue
        unit = unit_of("damping", recording.linear)
        said.append(
            f"{recording.axes[hold.axis]}: its hold is taken to act up to half a sample before the command, "
            f"as fits best; viscous friction of {friction:.2g} {unit} at its motor would look alike: record "
            "the demanded torque, or drive the axis without a hold, to tell"
        )
    return said


__all__ = ["diagnose"]
