"""The fit of a large motion: everything that identification and diagnosis share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from invid.errors import NotIdentifiableError
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.rigid_motion.load_friction import load_terms
from invid.rigid_motion.record_kind import grounded_axes
from invid.rigid_motion.regression import Design, Fit, fit_terms
from invid.rigid_motion.regressors import Extent, Regressor, base_terms, candidate_terms, extent
from invid.rigid_motion.selection import (
    Selection,
    fit_consistent_loads,
    fit_fast,
    is_needed,
    judged_rows,
    prune_terms,
    root_mean_square,
    select_terms,
)
from invid.signals.motion_record import Band, Motion, find_band, prepare_rows

RESOLUTION = 0.005
"""Share of the torque below which nothing counts as missing. Empirical: resampling, differentiation and held
torque leave up to 0.2 % on simulated axes without a cause."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """The analysis of a recording: base model, selected causes, rows, band."""

    recording: Recording
    band: Band
    motions: list[Motion]
    design: Design
    reach: Extent
    springs: set[int]
    candidates: list[Regressor]
    selection: Selection
    base: Fit
    final: Fit
    shape_std: dict[Regressor, float]


def analyse(recording: Recording) -> Analysis:
    """The base model that suits the data, and every cause that the data need.

    Raises
    ------
    NotIdentifiableError
        Where nothing moves enough for any row, or an inertia comes out negative.
    """
    band = find_band(recording.experiments)
    motions = [prepare_rows(e, band) for e in recording.experiments]
    if sum(int(m.keep.sum()) for m in motions) < 12:
        raise NotIdentifiableError(
            f"{recording.source}: the axes move in too little of the record (fewer than 12 rows); record "
            f"longer moves"
        )
    motions = [m for m in motions if m.keep.any()]
    design = Design(motions)
    motion_extent = extent(motions, not recording.linear)
    springs = grounded_axes(recording)
    base = base_terms(recording.axis_count, motion_extent.steady)
    base += [Regressor("ground_spring", i, ("stiffness",), base=True) for i in sorted(springs)]
    candidates = candidate_terms(recording.axis_count, motion_extent, springs)
    if not motion_extent.steady:
        design.bend(_fit_time_offsets(design, base, candidates))
    with budget.use_share(0.8, 0.1, 0.9):
        selection_made = select_terms(design, base, candidates)
    terms, spread = list(selection_made.final.terms), dict[Regressor, float]()
    if not budget.is_left_out("shapes of laws between those of the grid"):
        terms, spread = _refine_shapes(design, selection_made.final)
    terms = _fit_delays(design, terms, max(m.step for m in motions))
    final, is_kept = fit_consistent_loads(design, terms)
    if len(is_kept) < len(terms):
        # What stood only beside what went goes as well.
        final, is_kept = prune_terms(design, is_kept)
    terms = is_kept
    candidates += [t for t in load_terms(final, design) if not any(t.label == n.label for n in terms)]
    rigid = fit_terms(design, [t for t in final.terms if t.base])
    return Analysis(
        recording,
        band,
        motions,
        design,
        motion_extent,
        springs,
        candidates,
        selection_made,
        rigid,
        final,
        spread,
    )


def _fit_time_offsets(design: Design, base: list[Regressor], candidates: list[Regressor]) -> Float64:
    """(M,) time offset of each axis, every cause that is linear beside it; within a sample [s]."""
    plain = [t for t in candidates if t.shape is None and not t.replaces]
    quick = fit_terms(design, [*base, *plain])
    step = max(m.step for m in design.motions)
    late = np.zeros(design.axes)
    for term in base:
        if term.cause == "time_offset":
            late[term.axis] = np.clip(quick.of(term)[0][0], -step, step)
    return late


def _fit_delays(design: Design, terms: list[Regressor], step: float) -> list[Regressor]:
    """The terms with time offsets beyond a sample as delays where they are significant, else without them."""
    current = fit_terms(design, terms)
    for term in [t for t in terms if t.cause == "time_offset"]:
        value, std = current.of(term)
        if abs(value[0]) <= step + 2 * std[0]:
            continue
        without = fit_terms(design, [t for t in terms if t is not term])
        is_believed = is_needed(design, without, current) and _explains_most(design, without, current)
        if is_believed and _is_late_in_motion(design, terms, term, step):
            terms = [replace(t, cause="torque_delay", base=False) if t is term else t for t in terms]
        else:
            terms = without.terms
        current = fit_terms(design, terms)
    return terms


def _explains_most(design: Design, without: Fit, current: Fit) -> bool:
    """Whether the delay explains nine tenths of what is missing beyond noise.

    In closed loop anything else that is missing shows in the torque as well, a little later; a delay that
    leaves more may be another cause in disguise.
    """
    rows = judged_rows(design)
    noise = float(np.sum(design.noise[rows]))
    before, after = (float(np.sum(f.held_out[rows] ** 2)) for f in (without, current))
    return after - noise < 0.1 * (before - noise)


def _is_late_in_motion(design: Design, terms: list[Regressor], term: Regressor, step: float) -> bool:
    """Whether the torque is late also where no axis stands or reverses nearby.

    An axis that sticks before it reverses, where the model's friction follows the sign of the velocity, looks
    late by the time it sticks. That is friction, not the actuator.
    """
    rows = design.far & ~design.validate if design.has_validation else design.far
    if rows.sum() < 5 * sum(len(t.names) for t in terms):
        return False
    weight = design.weight.copy()
    design.weight = np.where(design.far, weight, 0.0)
    try:
        result = fit_terms(design, terms)
    finally:
        design.weight = weight
    value, std = result.of(term)
    share = rows.sum() / max((~design.validate).sum(), 1)
    return bool(abs(value[0]) > step + 3 * std[0] / np.sqrt(share))


def _refine_shapes(design: Design, result: Fit) -> tuple[list[Regressor], dict[Regressor, float]]:
    """Shape parameters between the grid points, with standard deviations from the cost's curvature."""
    terms = list(result.terms)
    spread: dict[Regressor, float] = {}
    for i, term in enumerate(terms):
        if term.shape is None:
            continue
        index, start = i, term.shape

        def cost(log_shape: float, index: int = index, term: Regressor = term) -> float:
            trial = [*terms]
            trial[index] = replace(term, shape=float(np.exp(log_shape)))
            return fit_fast(design, trial, 1.0).cost

        low, high = float(np.log(start / 3)), float(np.log(start * 3))
        found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3})
        terms[i] = replace(term, shape=float(np.exp(found.x)))
        h = 0.1
        curvature = (cost(found.x + h) - 2 * found.fun + cost(found.x - h)) / h**2
        variance = 2 * found.fun / max(curvature, 1e-300) / max(result.effective, 1.0)
        spread[terms[i]] = (
            float(terms[i].shape or 0.0) * float(np.sqrt(variance)) if curvature > 0 else np.inf
        )
    return terms, spread


def row_floor(analysis: Analysis) -> Float64:
    """(rows,) variance that white noise of torque and position alone leaves in each row."""
    design, band = analysis.design, analysis.band
    variance = design.noise.copy()
    for term in analysis.final.terms:
        if term.cause != "inertia":
            continue
        mass = float(analysis.final.of(term)[0][0])
        own_noise = design.axis == term.axis
        variance[own_noise] += mass**2 * float(band.accelerating()[term.axis])
    return variance


def sampling_error(analysis: Analysis) -> Float64:
    """(M,) largest rms torque that sampling leaves on a machine without a cause, beside its sensors'
    noise."""
    design, rows, floor = analysis.design, judged_rows(analysis.design), row_floor(analysis)
    out = np.zeros(design.axes)
    for i, steps in enumerate(quantisation_error(analysis)):
        axis_rows = rows & (design.axis == i)
        noise = np.sqrt(np.mean(floor[axis_rows]))
        out[i] = max(RESOLUTION * root_mean_square(design.torque[axis_rows]), float(np.hypot(noise, steps)))
    return out


def quantisation_error(analysis: Analysis) -> Float64:
    """(M,) largest rms torque that the counts of the encoder leave in the rows.

    At a constant speed the rounding is no white noise but a tone, at whatever frequency the sampling aliases
    it to: at worst all of it, count²/12, at the cut-off.
    """
    count: Float64 = np.max([m.counts for m in analysis.motions], axis=0)
    most = np.zeros_like(count)
    for term in analysis.final.terms:
        if term.cause == "inertia":
            bent = (2 * np.pi * analysis.band.rows_hz[term.axis]) ** 2 * count[term.axis] / np.sqrt(12.0)
            most[term.axis] = abs(float(analysis.final.of(term)[0][0])) * bent
    return most
