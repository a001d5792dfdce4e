"""The diagnosis of a recording: its kind, the search, lost samples, what it means for the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Literal

import numpy as np

from invid.diagnosis.consequence import grade_consequences
from invid.diagnosis.lost_samples import with_lost_samples
from invid.diagnosis.rigid import diagnose_trajectory
from invid.diagnosis.unknown_forces.elastic import diagnose_elastic
from invid.diagnosis.unknown_forces.structure_at_start import begin_with_structure
from invid.errors import InputError, NotIdentifiableError
from invid.identification.identify import requested_sizes
from invid.identification.machine_kind import is_of_rigid_axes, machine_kind
from invid.identification.search_start import SearchStart, begin_elastic
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model
from invid.numerics import budget
from invid.recording.model import Recording
from invid.recording.still_axes import masses_of_moving
from invid.signals.dropped_rows import find_dropped_rows, interpolate_dropped_rows
from invid.signals.plausibility import check_shaken, check_units
from invid.signals.repair import repair

TIME_TO_IDENTIFY = 0.5
"""Share of the budget for the first fit of chains beside that of rigid axes (empirical)."""


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
        kept = [w for w in result.warnings if not budget.is_warning(w)]
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
        begin = cache(partial(_begin, recording, repaired, requested_sizes(recording, masses)))
        with budget.use_share(1.0, 0.0, 0.3):
            kind = machine_kind(recording, masses, begin, TIME_TO_IDENTIFY)
        if kind.rigid:
            result = diagnose_trajectory(recording, analysis=kind.analysis)
        else:
            result = with_lost_samples(diagnose_elastic(begin()), recording, dropped)
        return replace(result, warnings=(*result.warnings, kind.sentence)) if kind.sentence else result
    if model.axes != recording.axes:
        raise InputError(
            f"the model has the axes {list(model.axes)}, the recording {list(recording.axes)}; diagnose with "
            "the model of this robot, or without one"
        )
    check_units(model, recording)
    check_shaken(recording)
    begun = begin_elastic(repaired, model.chains.masses_per_branch, model.chains, start=begin_with_structure)
    return with_lost_samples(diagnose_elastic(begun), recording, dropped)


def _begin(recording: Recording, repaired: Recording, sizes: tuple[int, ...] | None) -> SearchStart:
    """Where the search begins of a machine that is shaken; one that is moved need not show chains."""
    check_shaken(recording)
    return begin_elastic(repaired, sizes, start=begin_with_structure)


__all__ = ["diagnose"]
