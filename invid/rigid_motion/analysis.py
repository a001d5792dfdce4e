"""The fit of a large motion: everything that identification and diagnosis share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from invid.errors import NotIdentifiableError
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.rigid_motion.law_without_name import add_laws
from invid.rigid_motion.load_friction import load_terms
from invid.rigid_motion.record_kind import grounded_axes
from invid.rigid_motion.regression import Design, Fit, fit_terms, noise_of
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

EXPLAINED = 0.9
"""Share of what an axis misses that friction takes, or leaves nothing that depends on the velocity."""
FRICTION = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "asymmetric_friction",
    "load_dependent_friction",
)


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
    terms = list(selection_made.final.terms)
    if not budget.is_left_out("shapes of laws between those of the grid"):
        terms = _refine_shapes(design, terms)
    terms = _fit_delays(design, terms, max(m.step for m in motions))
    final, is_kept = fit_consistent_loads(design, terms)
    if len(is_kept) < len(terms):
        # What stood only beside what went goes as well.
        final, is_kept = prune_terms(design, is_kept)
    final = add_laws(design, _without_wrong_laws(design, final))
    terms = list(final.terms)
    candidates += [t for t in load_terms(final, design) if not any(t.label == n.label for n in terms)]
    rigid = fit_terms(design, [t for t in final.terms if t.base])
    final, spread = _with_shapes(design, final)
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
        # Beyond a sample, and not to be told from none: it would only bend what the data do show.
        lost = step < abs(value[0]) <= 2 * std[0]
        if abs(value[0]) <= step + 2 * std[0] and not lost:
            continue
        without = fit_terms(design, [t for t in terms if t is not term])
        sure = not lost and is_needed(design, without, current)
        is_believed = sure and _explains_most(design, without, current)
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
    rows = design.far & design.train
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


def _refine_shapes(design: Design, found: list[Regressor]) -> list[Regressor]:
    """The terms with shape parameters between the grid points."""
    terms = list(found)
    for i, term in enumerate(terms):
        if term.shape is None:
            continue
        index, start = i, term.shape

        def cost(log_shape: float, index: int = index, term: Regressor = term) -> float:
            trial = [*terms]
            trial[index] = replace(term, shape=float(np.exp(log_shape)))
            return fit_fast(design, trial, 1.0).cost

        low, high = float(np.log(start / 3)), float(np.log(start * 3))
        best = scipy.optimize.minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3}
        )
        terms[i] = replace(term, shape=float(np.exp(best.x)))
    return terms


def _with_shapes(design: Design, result: Fit) -> tuple[Fit, dict[Regressor, float]]:
    """The fit with what its shapes leave open in the covariance of all coefficients; the shapes' own std."""
    shaped = [t for t in result.terms if t.shape is not None]
    if not shaped:
        return result, {}
    h = 1e-3
    slopes = []
    for term in shaped:
        up, down = (
            design.columns(replace(term, shape=float(term.shape or 0.0) * np.exp(s))) for s in (h, -h)
        )
        slopes.append((up - down) @ result.of(term)[0] / (2 * h))
    matrix = np.column_stack([design.matrix(result.terms), *slopes]) * design.weight[:, None]
    matrix = matrix[design.train]
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale[scale == 0] = 1.0
    length = matrix.shape[0] / max(result.effective, 1.0)
    spread = result.cost * length * matrix.shape[0] / max(matrix.shape[0] - matrix.shape[1] * length, 1.0)
    inverse = np.linalg.pinv((matrix / scale).T @ (matrix / scale), rcond=1e-12) / np.outer(scale, scale)
    covariance, count = inverse * spread, result.value.size
    own = np.sqrt(np.diag(covariance)[count:])
    return (
        replace(result, covariance=covariance[:count, :count]),
        {t: float(t.shape or 0.0) * float(s) for t, s in zip(shaped, own, strict=True)},
    )


def _without_wrong_laws(design: Design, final: Fit) -> Fit:
    """The fit without friction on an axis where it leaves a tenth that still depends on the velocity.

    Friction there is, by a law that none of them is: of a drag with the square of the speed viscous friction
    takes most, at a size that means nothing.
    """
    rows = judged_rows(design)
    bare = fit_terms(design, [t for t in final.terms if t.base])
    wrong = set()
    for i in range(design.axes):
        mine = rows & (design.axis == i)
        noise = float(np.mean(design.noise[mine])) if mine.any() else 0.0
        before, after = (float(np.mean(f.held_out[mine] ** 2)) - noise for f in (bare, final))
        velocity = design.on_axis([m.rows(m.velocity) for m in design.motions], i)
        left = final.held_out[design.axis == i]
        if after > (1 - EXPLAINED) * before and depends_on(left, velocity, final.effective / design.axes):
            wrong.add(i)
    kept = [t for t in final.terms if t.axis not in wrong or t.cause not in FRICTION]
    return final if len(kept) == len(final.terms) else fit_consistent_loads(design, kept)[0]


def depends_on(residual: Float64, driver: Float64, effective: float) -> bool:
    """More than a tenth of the residual's power, and significant, in its mean over ten bins of ``driver``."""
    edges = np.quantile(driver, np.linspace(0, 1, 11)[1:-1])
    bins = np.searchsorted(edges, driver)
    sums = np.bincount(bins, residual, 10)
    counts = np.maximum(np.bincount(bins, minlength=10), 1)
    share = float(np.sum(sums**2 / counts) / max(np.sum(residual**2), 1e-300))
    return share > max(0.1, 20.0 / max(effective, 1.0))


def row_floor(analysis: Analysis) -> Float64:
    """(rows,) variance that white noise of torque and position alone leaves in each row."""
    return noise_of(analysis.design, analysis.final)


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
