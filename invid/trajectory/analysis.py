"""The fit of a large motion: everything that identification and diagnosis share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from invid.arrays import Float64
from invid.errors import NotIdentifiableError
from invid.recording.model import Recording
from invid.trajectory.kind import grounded_axes
from invid.trajectory.load import load_terms, settled
from invid.trajectory.motion import Band, Motion, find_band, prepare
from invid.trajectory.regression import Design, Fit, fit
from invid.trajectory.selection import Selection, fit_fast, needed, select
from invid.trajectory.terms import Extent, Term, base_terms, candidate_terms, extent


@dataclass(frozen=True, eq=False)
class Analysis:
    """A recording analysed: base model, selected causes, rows, band."""

    recording: Recording
    band: Band
    motions: list[Motion]
    design: Design
    reach: Extent
    springs: set[int]
    candidates: list[Term]
    selection: Selection
    base: Fit
    final: Fit
    shape_std: dict[Term, float]


def analyse(recording: Recording) -> Analysis:
    """Fit the base model that suits the data, then every cause the data ask for.

    Raises
    ------
    NotIdentifiableError
        Where nothing moves enough for any row, or an inertia comes out negative.
    """
    band = find_band(recording.experiments)
    motions = [prepare(e, band) for e in recording.experiments]
    if sum(int(m.keep.sum()) for m in motions) < 12:
        raise NotIdentifiableError(
            f"{recording.source}: the axes move in too little of the record (fewer than 12 rows); record "
            f"longer moves"
        )
    motions = [m for m in motions if m.keep.any()]
    design = Design(motions)
    reach = extent(motions, not recording.linear)
    springs = grounded_axes(recording)
    base = base_terms(recording.axis_count, reach.steady)
    base += [Term("ground_spring", i, ("stiffness",), base=True) for i in sorted(springs)]
    candidates = candidate_terms(recording.axis_count, reach, springs)
    chosen = select(design, base, candidates)
    terms, spread = _refined(design, chosen.final)
    terms = _delays(design, terms, max(m.step for m in motions))
    terms = settled(design, terms)
    final = fit(design, terms)
    candidates += [t for t in load_terms(final, design) if not any(t.label == n.label for n in terms)]
    rigid = fit(design, [t for t in final.terms if t.base])
    return Analysis(
        recording, band, motions, design, reach, springs, candidates, chosen, rigid, final, spread
    )


def _delays(design: Design, terms: list[Term], step: float) -> list[Term]:
    """Time offsets beyond a sample are no convention: a cause where the data insist, else taken out."""
    current = fit(design, terms)
    for term in [t for t in terms if t.cause == "time_offset"]:
        value, std = current.of(term)
        if abs(value[0]) <= step + 2 * std[0]:
            continue
        without = fit(design, [t for t in terms if t is not term])
        if needed(design, without, current) and _late_while_moving(design, terms, term, step):
            terms = [replace(t, cause="torque_delay", base=False) if t is term else t for t in terms]
        else:
            terms = without.terms
        current = fit(design, terms)
    return terms


def _late_while_moving(design: Design, terms: list[Term], term: Term, step: float) -> bool:
    """Whether the torque is late also where no axis stands or turns round near by.

    An axis that sticks before it turns, where the model's friction changes sign with the velocity, looks late
    by as long as it sticks. That is friction, not the actuator.
    """
    rows = design.far & ~design.validate if design.has_validation else design.far
    if rows.sum() < 5 * sum(len(t.names) for t in terms):
        return False
    weight = design.weight.copy()
    design.weight = np.where(design.far, weight, 0.0)
    try:
        result = fit(design, terms)
    finally:
        design.weight = weight
    value, std = result.of(term)
    share = rows.sum() / max((~design.validate).sum(), 1)
    return bool(abs(value[0]) > step + 3 * std[0] / np.sqrt(share))


def _refined(design: Design, result: Fit) -> tuple[list[Term], dict[Term, float]]:
    """Shape parameters between the grid points, with standard deviations from the cost's curvature."""
    terms = list(result.terms)
    spread: dict[Term, float] = {}
    for i, term in enumerate(terms):
        if term.shape is None:
            continue
        index, start = i, term.shape

        def cost(log_shape: float, index: int = index, term: Term = term) -> float:
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
        own = design.axis == term.axis
        cutoff = float(band.rows_hz[term.axis])
        # White position noise through ω⁴ up to the cut-off.
        accelerating = band.position_psd[term.axis] * (2 * np.pi) ** 4 * cutoff**5 / 5
        variance[own] += mass**2 * accelerating
    return variance
