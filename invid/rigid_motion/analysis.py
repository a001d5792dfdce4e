"""The fit of a large motion: everything that identification and diagnosis share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.effects.supposed.law import SupposedLaw
from invid.errors import NotIdentifiableError
from invid.likelihood.unknown_forces.price import pays, price
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.rigid_motion.fit import (
    Fit,
    axis_powers,
    falls,
    fit_terms,
    load_terms,
    missing_powers,
    missing_torque,
    settled,
)
from invid.rigid_motion.memory import with_memory
from invid.rigid_motion.record_kind import grounded_axes
from invid.rigid_motion.rows import Rows, colour_of
from invid.rigid_motion.search import search, without_harm
from invid.rigid_motion.smooth_law import add_laws, any_law, without_wrong_laws
from invid.rigid_motion.terms import (
    COGGING,
    Base,
    Extent,
    Term,
    base_terms,
    candidate_terms,
    extent,
    first_terms,
)
from invid.signals.motion_record import Band, motions_of

NEARLY_ALL = 0.1
"""Share of what is missing beyond noise that a delay may leave: in closed loop anything else that is missing
shows in the torque as well, a little later (empirical)."""
LEAST_ROWS = 12
"""Rows of motion from which on anything is fitted (three to a number of the plainest model: statistical)."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """The analysis of a recording: rows, what may act, what does, and the rigid model alone (``base``)."""

    recording: Recording
    band: Band
    rows: Rows
    reach: Extent
    springs: set[int]
    candidates: list[Term]
    base: Fit
    final: Fit
    is_cut_short: bool
    """Whether the budget ended the search."""


def analyse(recording: Recording) -> Analysis:
    """The base model that suits the data, and every cause that the data need.

    Raises
    ------
    NotIdentifiableError
        Where nothing moves enough for any row.
    """
    motions = motions_of(recording)
    count = sum(int(m.keep.sum()) for m in motions)
    if count < LEAST_ROWS:
        raise NotIdentifiableError(
            f"{recording.source}: the axes move in too little of the record ({count} rows, fewer than "
            f"{LEAST_ROWS})",
            way_out="record longer moves",
            code="too_little_motion",
            values={"rows": count, "least": LEAST_ROWS},
        )
    motions = [m for m in motions if m.keep.any()]
    rows, reach = Rows(motions), extent(motions, not recording.linear)
    springs = grounded_axes(recording)
    base = base_terms(reach, springs)
    candidates = candidate_terms(reach, springs, motions)
    first = [*base, *first_terms(reach, springs)]
    fullest = [*first, *(t for t in candidates if _is_of_fullest(t))]
    fullest += [t for i in range(rows.axes) for t in any_law(rows, i, "velocity")]
    late = np.zeros(rows.axes) if reach.steady else _time_offsets(rows, fit_terms(rows, first))
    rows.bend(late)
    rows.set_colour(colour_of(rows, fit_terms(rows, fullest).residual))
    with budget.use_share(0.8, 0.1, 0.9):
        final, is_cut = search(rows, first, candidates)
        settled_offsets = _with_delays(rows, final)
        if settled_offsets is not final:
            final, is_cut = search(rows, settled_offsets.terms, candidates)
    final = add_laws(rows, without_wrong_laws(rows, final))
    if not reach.steady:
        rows, final = with_memory(rows, final, candidates)
    final = without_harm(rows, final)
    loads = [t for t in load_terms(rows, final) if all(t.label != n.label for n in final.terms)]
    rigid = fit_terms(rows, [t for t in final.terms if t.is_base])
    return Analysis(
        recording, motions[0].band, rows, reach, springs, [*candidates, *loads], rigid, final, is_cut
    )


def _is_of_fullest(term: Term) -> bool:
    """Whether a candidate belongs to the fullest model: what that leaves is how the unknown force is
    correlated, and what a simpler one leaves beside is what it lacks."""
    if term.law is Base.CARRIED:
        return True
    is_bend_of_one_kind = len(term.shape) < 2 or term.shape[1] == 2.0
    return isinstance(term.law, SupposedLaw) and term.law is not COGGING and is_bend_of_one_kind


def _time_offsets(rows: Rows, quick: Fit) -> Float64:
    """(M,) time offset of each axis within a sample [s]."""
    step, late = max(m.step for m in rows.motions), np.zeros(rows.axes)
    for term in quick.terms:
        if term.law is Base.TIME_OFFSET:
            late[term.axis] = np.clip(quick.of(term)[0][0], -step, step)
    return late


def _with_delays(rows: Rows, current: Fit) -> Fit:
    """The fit with time offsets beyond a sample as delays where they are sure, else without them."""
    step = max(m.step for m in rows.motions)
    for term in [t for t in current.terms if t.law is Base.TIME_OFFSET]:
        value, std = current.of(term)
        # Beyond a sample, and not to be told from none: it would only bend what the data do show.
        is_lost = step < abs(value[0]) <= 2 * std[0]
        if abs(value[0]) <= step + 2 * std[0] and not is_lost:
            continue
        bare = settled(rows, [t for t in current.terms if t is not term])
        is_sure = not is_lost and pays(*falls(bare, current), price())
        is_most = bool(missing_powers(rows, current).sum() < NEARLY_ALL * missing_powers(rows, bare).sum())
        if is_sure and is_most and _is_late_in_motion(rows, current, term, step):
            terms = [replace(t, law=Base.DELAY) if t is term else t for t in current.terms]
            current = settled(rows, terms)
        else:
            current = bare
    return current


def _is_late_in_motion(rows: Rows, current: Fit, term: Term, step: float) -> bool:
    """Whether the torque is late also where no axis stands or reverses nearby.

    An axis that sticks before it reverses, where the model's friction follows the sign of the velocity, looks
    late by the time it sticks. That is friction, not the actuator.
    """
    everywhere, seen = rows.train, rows.far & rows.train
    if seen.sum() < 5 * current.value.size:
        return False
    rows.train = seen
    try:
        value, std = fit_terms(rows, current.terms).of(term)
    finally:
        rows.train = everywhere
    return bool(abs(value[0]) > step + 3 * std[0])


def missed_by(rows: Rows, result: Fit) -> Float64:
    """(M,) rms torque that each axis misses in every row kept out."""
    return np.sqrt(axis_powers(rows.every, rows.every.judged, missing_torque(rows, result)))
