"""Recording to model: the likelihood of chains with friction at the motors, or the paper's inverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Literal

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.identification.elastic_model import model_of_chains
from invid.identification.machine_kind import machine_kind, rigid_model
from invid.identification.paper_model import paper_model
from invid.identification.search_start import SearchStart, begin_elastic
from invid.identification.stated_inertia import against_stated
from invid.model.document import Model
from invid.numerics import budget
from invid.recording.model import Recording, Role
from invid.recording.still_axes import masses_of_moving
from invid.signals.plausibility import check_shaken
from invid.signals.repair import repair

TIME_TO_SEARCH = 0.9
"""Share of a budget for everything but covariances and sentences about the model (empirical)."""

Masses = Sequence[int] | Literal["auto"] | None
Method = Literal["paper", "refined"]


def identify(recording: Recording, *, masses: Masses = None, method: Method = "refined") -> Model:
    """Masses, springs, dampers and couplings of every branch with their covariance.

    Parameters
    ----------
    masses
        Masses of each axis; ``None`` takes those of the recording, and "auto" where it names none;
        "auto" lets the data choose.
    method
        "refined" (maximum likelihood) or "paper" (the inverse eigenvalue method on measured resonances).

    Returns
    -------
    Model
        ``fit["trustworthy"]`` is False where a reason in ``warnings`` says that it cannot be relied on.

    Raises
    ------
    InputError
        An axis that is never excited; masses that do not match the axes.
    NotIdentifiableError
        Data from which no such model can be drawn at all; an excitation that drowns in the noise.
    """
    whole = recording
    recording, warnings = repair(recording)
    masses = masses_of_moving(masses, whole, recording)
    # Steps far from the solution may overflow; the search sees it in their cost and takes them back.
    with budget.use_share(TIME_TO_SEARCH), np.errstate(all="ignore"):
        try:
            model = _identify_kind(recording, masses, method)
        except np.linalg.LinAlgError as error:
            raise NotIdentifiableError(
                f"{recording.source}: no chain of masses and springs fits these records to any finite error "
                f"({error})",
                way_out="check the signs and units of position and torque, and the number of masses",
                code="nothing_fits",
            ) from None
    budget_warning = budget.warning()
    warnings = warnings if budget_warning is None else [*warnings, budget_warning]
    model = replace(model, warnings=(*model.warnings, *warnings)) if warnings else model
    return against_stated(model, whole)


def _identify_kind(recording: Recording, masses: Masses, method: Method) -> Model:
    """Model of rigid inertias or of chains, by the kind of the recording."""
    sizes = requested_sizes(recording, masses)
    begin = cache(partial(_begin, recording, sizes))
    if method == "paper":
        return paper_model(begin())
    kind = machine_kind(recording, masses, begin)
    if kind.rigid:
        return rigid_model(recording, kind)
    model = model_of_chains(begin())
    return replace(model, warnings=(*model.warnings, kind.sentence)) if kind.sentence else model


def _begin(recording: Recording, sizes: tuple[int, ...] | None) -> SearchStart:
    check_shaken(recording)
    # Not even holds are read, or starts, from what is for validation.
    own = tuple(e for e in recording.experiments if e.role is Role.IDENTIFY)
    begun = begin_elastic(replace(recording, experiments=own), sizes)
    return begun if len(own) == len(recording.experiments) else replace(begun, stopgap=())


def requested_sizes(recording: Recording, masses: Masses) -> tuple[int, ...] | None:
    """Masses of each axis as asked for or recorded; ``None`` where the data are to choose.

    Raises
    ------
    InputError
        Not one number of at least one for each axis.
    """
    wanted = recording.masses_per_axis if masses is None else masses
    if wanted is None or isinstance(wanted, str):
        return None
    sizes = tuple(int(n) for n in wanted)
    if len(sizes) != recording.axis_count or any(n < 1 for n in sizes):
        raise InputError(
            f"masses: {list(wanted)} for {recording.axis_count} axes {list(recording.axes)}; give one number "
            "≥ 1 for each axis, or auto"
        )
    return sizes


__all__ = ["identify", "requested_sizes"]
