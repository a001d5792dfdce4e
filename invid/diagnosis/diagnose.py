"""The diagnosis of a recording: fit, search, judgement, check over time, sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Literal

import numpy as np

from invid.diagnosis.consequence import grade_consequences
from invid.diagnosis.rigid import diagnose_trajectory
from invid.diagnosis.rules.dropped_rows import (
    find_dropped_rows,
    interpolate_dropped_rows,
)
from invid.diagnosis.rules.own_evidence import keep_independent_causes
from invid.diagnosis.selection import Selection
from invid.diagnosis.unknown_forces.elastic import Begun, begin_elastic, diagnose_elastic
from invid.effects.units import unit_of
from invid.errors import InputError, NotIdentifiableError
from invid.identification.machine_kind import ChainsTried, is_of_rigid_axes, machine_kind
from invid.likelihood.joint_fit import JointFit
from invid.model.diagnosis_document import Alternative, Diagnosis, Finding, RuledOut
from invid.model.document import EffectTerm, Model
from invid.numerics import budget
from invid.recording.model import Recording
from invid.recording.still_axes import masses_of_moving
from invid.signals.plausibility import check_recording, check_units
from invid.signals.repair import repair
from invid.signals.spectral_record import SpectralRecord

NOTABLE_SHARE = 0.1
"""Share of a hold inside the drive from which a warning says so (empirical)."""

TIME_TO_IDENTIFY, TIME_TO_SEARCH = 0.5, 0.85
"""Share of the budget for the identification, and of the rest for the search; what remains is for the
simulation over time and the sentences (empirical)."""

GIVEN_MODEL_PREFIX = "the model given, of its own recording: "
"""Prefix of warnings that come from the identification of a model made from other data."""


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
    whole = recording
    recording, notes = repair(recording, None if model is None else model.axes)
    masses = masses_of_moving(masses, whole, recording)
    # Steps far from the solution may overflow; the search sees it in their cost and takes them back.
    with np.errstate(all="ignore"):
        try:
            result = _diagnose_clean(recording, model, masses)
        except np.linalg.LinAlgError as error:
            raise NotIdentifiableError(
                f"{recording.source}: the model is so far from these records that no fit of both is finite "
                f"({error}); give the model of this robot, or diagnose without one"
            ) from None
    budget_warning = budget.warning()
    if budget_warning is not None:
        kept = [w for w in result.warnings if not w.startswith(budget.SPENT)]
        result = replace(result, warnings=(*kept, budget_warning))
    if notes:
        result = replace(result, warnings=tuple(dict.fromkeys([*result.warnings, *notes])))
    return grade_consequences(result, recording)


def _diagnose_clean(
    recording: Recording, model: Model | None, masses: Sequence[int] | Literal["auto"] | None
) -> Diagnosis:
    """The diagnosis of a recording that is repaired."""
    if model is not None and is_of_rigid_axes(model, recording):
        return diagnose_trajectory(recording, model=model)
    dropped = find_dropped_rows(recording)
    repaired = interpolate_dropped_rows(recording, dropped) if dropped else recording
    if model is None:
        check_recording(recording)
        sizes = _requested_sizes(recording, masses)
        begin = cache(partial(begin_elastic, repaired, sizes))
        with budget.use_share(1.0, 0.0, 0.3):
            kind = machine_kind(recording, masses, lambda: _chains_tried(begin()), TIME_TO_IDENTIFY)
        if kind.rigid:
            result = diagnose_trajectory(recording, analysis=kind.analysis)
        else:
            result = diagnose_elastic(begin())
        return replace(result, warnings=(*result.warnings, kind.sentence)) if kind.sentence else result
    if model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    check_units(model, recording)
    return diagnose_elastic(begin_elastic(repaired, model.chains.masses_per_branch))


def _chains_tried(begun: Begun) -> ChainsTried:
    return ChainsTried(begun.sizes, lambda: begun.missed)


def _requested_sizes(
    recording: Recording, masses: Sequence[int] | Literal["auto"] | None
) -> tuple[int, ...] | None:
    """Masses of each axis as asked for or recorded; ``None`` where the data are to choose."""
    wanted = recording.masses_per_axis if masses is None else masses
    return None if wanted is None or isinstance(wanted, str) else tuple(wanted)


def _without_the_rest(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection:
    """What may be named of causes that explain too little together; all of them where no time is left to
    tell."""
    alone = partial(keep_independent_causes, found, train, held)
    independent = budget.or_else("own evidence", alone, None)
    if independent is not None:
        return independent.widen_by_remainder()
    return replace(found, is_cut_short=found.is_cut_short or budget.is_spent())


def _without_found(
    limits: Sequence[RuledOut], findings: Sequence[Finding], identified: Sequence[EffectTerm]
) -> tuple[RuledOut, ...]:
    """The limits of what is neither found, nor an alternative, nor in the identification of the recording."""
    said: list[EffectTerm | Alternative] = [*identified, *(f.effect for f in findings)]
    said += [a for f in findings for a in f.alternatives]
    found = {(x.cause, x.axis, x.element, x.other_axis) for x in said}
    return tuple(r for r in limits if (r.cause, r.axis, r.element, r.other_axis) not in found)


def hold_timing_warnings(final: JointFit, recording: Recording) -> list[str]:
    """Warnings about holds whose timing no record shows and that the fit places before the command."""
    layout, warnings = final.layout, []
    for hold, share in zip(layout.holds, final.p[layout.hold_slice], strict=True):
        friction = 0.5 * layout.step * float(share) * hold.stiffness
        if hold.damping or share < NOTABLE_SHARE:
            continue
        unit = unit_of("damping", recording.linear)
        warnings.append(
            f"{recording.axes[hold.axis]}: its hold is taken to act up to half a sample before the command, "
            f"as fits best; viscous friction of {friction:.2g} {unit} at its motor would look alike: record "
            "the demanded torque, or drive the axis without a hold, to tell"
        )
    return warnings


__all__ = ["diagnose"]
