"""Residual and Jacobian of the linear plant with effects, for all records.

r = Z Θ − A T + Σ contributions, whitened with C_r = [Z, −A] C_n [Z, −A]ᴴ plus the scatter between periods.
The Jacobian of the linear parameters is taken at the projected measurement (the cost's gradient is then exact
for errors in variables); that of effects by differences, which costs one evaluation of the effect and no new
plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from invid.effects.catalogue.torque_delay import ActuatorEffect
from invid.effects.motion import View
from invid.likelihood.effect_derivatives import (
    effect_columns,
    impedance_columns,
    jump_columns,
    law_columns,
    learn_inner_response,
    moves_inner_masses,
    response_columns,
)
from invid.likelihood.hypothesis import (
    ActingTorque,
    Layout,
    acting_torque,
    aliased_motion,
    prior_residuals,
    step_times,
)
from invid.likelihood.nuisance.initial_states import solve_initial_states
from invid.likelihood.nuisance.transients import Ends, record_ends, solve_record_ends
from invid.likelihood.placed_effect import Candidate, contributions, is_linear_in_motion
from invid.likelihood.residual import covariance_of_missing, plants_of
from invid.model.transient_terms import end_derivative
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import factored, stack, unstack, unwhitener, whitener
from invid.signals.spectral_record import SpectralRecord


@dataclass(frozen=True, eq=False)
class RecordEvaluation:
    """One record through one plant with its effects: its residual and what the Jacobian needs."""

    view: View
    extra: Complex128
    """(F, M) contributions of the effects."""
    missing: Complex128
    """(F, M) missing torque r, boundary terms projected out."""
    covariance: Complex128
    root: Complex128
    basis: Float64
    """(rows, k) orthonormal basis of the whitened columns of ends and initial states."""
    jumps: Float64
    """(2ΣN + 2 for each mass of an effect,) jumps between the ends of a record that does not close; empty for
    one that does."""
    ends: Ends | None
    acting: ActingTorque
    white: Float64
    """(rows,) whitened residual."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residual and Jacobian, and the evaluations of the single records."""

    residual: Float64
    jacobian: Float64
    cost: float
    parts: tuple[RecordEvaluation, ...]
    dof: int = 0

    @property
    def views(self) -> tuple[View, ...]:
        """The records through the plant."""
        return tuple(s.view for s in self.parts)

    @property
    def missing(self) -> tuple[Complex128, ...]:
        """(F, M) missing torque r of every record, boundary terms projected out."""
        return tuple(s.missing for s in self.parts)

    @property
    def covariance(self) -> tuple[Complex128, ...]:
        """(F, M, M) covariance of the missing torque of every record."""
        return tuple(s.covariance for s in self.parts)

    @property
    def bases(self) -> tuple[Float64, ...]:
        """(rows, k) bases of the columns of ends and initial states of every record."""
        return tuple(s.basis for s in self.parts)

    @property
    def roots(self) -> tuple[Complex128, ...]:
        """(F, M, M) whiteners of the missing torque, for every record."""
        return tuple(s.root for s in self.parts)

    @property
    def records(self) -> list[SpectralRecord]:
        """The records that were evaluated."""
        return [s.view.record for s in self.parts]


def record_views(
    layout: Layout,
    records: Sequence[SpectralRecord],
    p: Float64,
    acting: Sequence[ActingTorque] | None = None,
) -> list[View]:
    """Every record through the plant at ``p`` (n,); ``acting``: its acting torques there, where they are
    known."""
    structure = layout.structure
    sp = p[: structure.count]
    values = structure.physical(sp)
    inertance = structure.inertance(sp)
    out = []
    if acting is None:
        acting = [acting_torque(r, layout, p) for r in records]
    plants = plants_of(structure, sp, records)
    for record, torque, (motion, stiffness, inner) in zip(records, acting, plants, strict=True):
        out.append(
            View(
                record,
                structure,
                motion,
                stiffness,
                inner,
                torque.torque,
                values[structure.slices["spring"]],
                values[structure.slices["damper"]],
                values[structure.slices["mass"]],
                layout.origin,
                np.einsum("fij,fj->fi", stiffness, aliased_motion(record, layout, p, inertance)),
                inertance,
                structure.couplings(values),
                structure.grounds(values),
                step_times(record, layout, p),
            )
        )
    return out


def evaluate(  # noqa: PLR0913 - a fit's point and how it is taken
    layout: Layout,
    records: Sequence[SpectralRecord],
    p: Float64,
    candidate: Candidate,
    *,
    jacobian: bool = True,
    near: Sequence[View] = (),
    thorough: bool = False,
    limit: float = np.inf,
) -> Evaluation:
    """Whitened residual (rows,) and Jacobian (rows, parameters of the layout, then of the effects).

    ``near``: the views of an evaluation close by, whose inner motion is the start here. ``thorough``: the
    Jacobian contains how strong effects change with the inner motion that the linear parameters change.
    ``limit``: where some records cost more together, the others are left out, and nothing but that is said.
    """
    before = near if candidate.terms and len(near) == len(records) else [None] * len(records)
    acting = [acting_torque(r, layout, p) for r in records]
    views = record_views(layout, records, p, acting)
    priors, _ = prior_residuals(layout, p, 0)
    parts, least = list[RecordEvaluation](), 0.0
    for view, torque, around in zip(views, acting, before, strict=True):
        parts.append(_evaluate_record(view, torque, layout, p, candidate, around))
        least += float(parts[-1].white @ parts[-1].white)
        if least > limit and len(parts) < len(views):
            return Evaluation(np.zeros(0), np.zeros((0, 0)), np.inf, tuple(parts))
    residual = np.concatenate([*(s.white for s in parts), priors])
    dof = sum(_degrees_of_freedom(s) for s in parts)
    here = Evaluation(residual, np.zeros((0, 0)), float(residual @ residual), tuple(parts), dof)
    return add_jacobian(here, layout, p, candidate, thorough=thorough) if jacobian else here


def add_jacobian(
    here: Evaluation, layout: Layout, p: Float64, candidate: Candidate, *, thorough: bool
) -> Evaluation:
    """The same evaluation, at the same parameters, with its Jacobian."""
    parts = [_record_jacobian(s, layout, p, candidate, thorough) for s in here.parts]
    _, prior_rows = prior_residuals(layout, p, sum(t.size for t in candidate.terms))
    return replace(here, jacobian=np.concatenate([*parts, prior_rows]))


def _evaluate_record(
    view: View, acting: ActingTorque, layout: Layout, p: Float64, candidate: Candidate, before: View | None
) -> RecordEvaluation:
    """One record through a plant with effects; ``before``: a view close by whose inner motion is the
    start."""
    record = view.record
    r: Complex128 = np.einsum("fij,fj->fi", view.stiffness, record.position) - view.acting - view.images
    covariance = residual_covariance(view, acting.factor, candidate)
    view.certainty = np.asarray(np.linalg.inv(covariance), dtype=np.complex128)
    root = whitener(covariance)
    if record.weight.size:
        root = root * record.weight[:, None, None]
    rows, ends = 2 * r.size, None
    end_columns, basis, jumps = np.zeros((rows, 0)), np.zeros((rows, 0)), np.zeros(0)
    if record.transient:
        ends = record_ends(view, layout, p)
        ends_felt = ends.with_effects(view, candidate)
        end_columns = stack(root @ ends_felt.torque)
        basis, back = factored(end_columns)
        view.closing = solve_record_ends(view, ends_felt, root, r)
        view.set_inner_motion(view.feedback, view.closing_jumps(np.zeros_like(r)))
        view.missing = view.missing_with(np.zeros_like(r))
    else:
        view.missing = r
    if before is not None:
        view.end_motion, view.starts = before.end_motion, dict(before.starts)
        view.set_equivalents(before.equivalents)
        is_alike = before.jumps.size == view.jumps.size  # a mass of an effect's own has jumps of its own
        view.secants = before.secants if is_alike else view.secants
        view.set_inner_motion(before.feedback, before.jumps if is_alike else view.jumps)
    extra = contributions(view, candidate)
    extra, starting = solve_initial_states(view, candidate, extra, partial(_chi2_of, root, basis, r))
    if starting.any():
        basis, back = factored(np.column_stack((end_columns, stack(root @ starting))))
    if not any(t.depends_on_inner_motion(view) for t in candidate.terms):
        view.set_inner_motion(view.feedback, view.closing_jumps(extra))
    r = r + extra
    white = stack(root @ r[..., None])[:, 0]
    if basis.size:
        within = basis.T @ white
        along = basis @ within
        white = white - along
        r = r - unstack(unwhitener(root), along, r.shape)
        jumps = -(back @ within)[: end_columns.shape[1]]
    if record.transient:
        view.end_motion = ends_felt.motion @ jumps
    view.remaining = r
    return RecordEvaluation(view, extra, r, covariance, root, basis, jumps, ends, acting, white)


def _degrees_of_freedom(part: RecordEvaluation) -> int:
    """Degrees of freedom of a record."""
    record, motors = part.view.record, part.missing.shape[1]
    lines = int(record.weight.sum()) if record.weight.size else record.omega.size
    out: int = 2 * lines * motors - motors - part.basis.shape[1]
    return out


def _record_jacobian(
    evaluated: RecordEvaluation, layout: Layout, p: Float64, candidate: Candidate, thorough: bool
) -> Float64:
    """(rows, n) derivative of a record's whitened residual."""
    view, r, sp = evaluated.view, evaluated.missing, p[: layout.structure.count]
    effects = sum(t.size for t in candidate.terms)
    gain = np.asarray(np.linalg.solve(evaluated.covariance, r[..., None])[..., 0], dtype=np.complex128)
    columns = np.zeros((*r.shape, layout.count + effects), dtype=complex)
    columns[..., : layout.count], q = _linear_columns(
        layout, p, view, gain, evaluated.jumps, evaluated.acting, _actuator_gain(view, candidate)
    )
    strong = thorough and not is_linear_in_motion(candidate) and moves_inner_masses(view, candidate)
    impedance_columns(view, candidate, sp, q, columns)
    is_complete = not is_linear_in_motion(candidate) and response_columns(
        view, candidate, sp, q, columns, layout.count, strong=strong
    )
    if not is_complete:
        if strong and evaluated.ends is not None:
            learn_inner_response(view, candidate)
        effect_columns(view, candidate, columns, layout.count)
    if evaluated.ends is not None:
        jump_columns(view, candidate, evaluated.ends.motion, evaluated.jumps, columns, layout.count)
    if strong and not is_complete:
        law_columns(view, candidate, sp, q, columns, layout.count)
    part: Float64 = stack(evaluated.root @ columns)
    return part - evaluated.basis @ (evaluated.basis.T @ part) if evaluated.basis.size else part


def _chi2_of(root: Complex128, basis: Float64, r: Complex128, extra: Complex128) -> float:
    """χ² of the missing torque ``r`` + ``extra`` (F, M), the part along ``basis`` projected out."""
    white = stack(root @ (r + extra)[..., None])[:, 0]
    along = basis.T @ white
    return float(white @ white - along @ along)


def _linear_columns(  # noqa: PLR0913 - the terms of the derivative
    layout: Layout,
    p: Float64,
    view: View,
    gain: Complex128,
    jumps: Float64,
    acting: ActingTorque,
    actuator_gain: Complex128,
) -> tuple[Complex128, Complex128]:
    """(F, M, parameters) derivative of r by the layout's parameters, and (F, ΣN) the motion at which it is
    taken.

    ``gain`` (F, M) is C_r⁻¹ r, ``jumps`` (2ΣN,) the ends of a record that does not close (empty for one that
    does), ``actuator_gain`` (F, M) the transfer of the acting torque through actuator effects.
    """
    structure, record = layout.structure, view.record
    sp, motors = p[: structure.count], structure.motors
    # Only the sensors' noise moves the measurement: the scatter's share is in the covariance.
    expected = record.noise[:, :motors] * np.einsum("fij,fi->fj", view.stiffness.conj(), gain)
    q = np.einsum("fqm,fm->fq", view.motion, record.position - expected) + view.feedback + view.end_motion
    columns = np.zeros((*record.torque.shape, layout.count), dtype=complex)
    columns[..., : structure.count] = structure.torque_derivative(sp, record.omega, view.motion, q[None])[0]
    if jumps.size:
        columns[..., : structure.count] += end_derivative(
            structure, sp, record.omega, view.motion, jumps[: 2 * structure.dofs], record.span
        )
    at = structure.count
    by_delay = 1j * record.omega[:, None] * view.acting * actuator_gain
    for k, i in enumerate(layout.free_delays):
        columns[:, i, at + k] = by_delay[:, i]
    at += len(layout.free_delays)
    for k, i in enumerate(layout.free_zoh):
        columns[:, i, at + k] = -acting.by_zoh_share[:, i] * actuator_gain[:, i]
        if i in layout.late_zoh_axes and record.command is None:
            columns[:, i, at + k] += 0.5 * layout.step * by_delay[:, i]
    at += len(layout.free_zoh)
    for k, hold in enumerate(layout.holds):
        columns[:, hold.axis, at + k] = -acting.by_hold[:, k] * actuator_gain[:, hold.axis]
    at += len(layout.holds)
    by_lag = -by_delay / layout.inverse_lag(p, record.omega)  # jω where 1 + jωτ was
    for k, i in enumerate(layout.smoothed):
        columns[:, i, at + k] = by_lag[:, i]
    return columns, q


def _actuator_gain(view: View, candidate: Candidate) -> Complex128:
    """(F, M) transfer of the acting torque through delays and lags of the actuators."""
    out: Complex128 = np.ones_like(view.acting)
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if isinstance(term.effect, ActuatorEffect):
            out[:, term.place.axis] += term.effect.response(view, term.place, x.tolist()) - 1.0
    return out


def count_per_line(record: SpectralRecord, root: Complex128) -> Float64:
    """(F,) real numbers that each axis has on every line: 2, 1 at 0 Hz, 0 where ``root`` (F, M, M) leaves it
    out."""
    out: Float64 = np.where(record.omega == 0.0, 1.0, 2.0) * (np.abs(root).sum(axis=(1, 2)) > 0)
    return out


def residual_covariance(view: View, factor: Complex128, candidate: Candidate | None = None) -> Complex128:
    """(F, M, M) covariance of r; an effect that scales a sensor scales its noise as well.

    Without that, of two scales that fit alike the one with the larger apparent noise would win.
    """
    record = view.record
    motors = record.torque.shape[1]
    noise = record.noise
    for term, x in () if candidate is None else zip(candidate.terms, candidate.x, strict=True):
        position, torque = term.effect.noise_power(view, term.place, x.tolist())
        if np.any(position != 1.0) or np.any(torque != 1.0):
            noise = noise.copy()
            noise[:, term.place.axis] *= position
            noise[:, motors + term.place.axis] *= torque
    covariance = covariance_of_missing(view.stiffness, factor, noise)
    index = np.arange(motors)
    covariance[:, index, index] += record.scatter
    return covariance
