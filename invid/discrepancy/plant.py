"""The linear plant with effects, fitted jointly to the missing torque of all records.

r = Z Θ − A T + Σ contributions, whitened with C_r = [Z, −A] C_n [Z, −A]ᴴ times what the scatter between
periods adds. The Jacobian of the linear parameters is taken at the projected measurement (the cost's
gradient is then exact for errors in variables); that of effects by differences, which costs one
evaluation of the effect and no new plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.arrays import Complex128, Float64
from invid.discrepancy.inner import settled
from invid.discrepancy.layout import Layout, acting_of, priors_of
from invid.effects.base import Effect, ImpedanceEffect, Place, Record, View
from invid.effects.torque_delay import ActuatorEffect
from invid.refine.boundary import end_columns, end_derivative, end_forces, end_places, end_points
from invid.refine.problem import condense_dense
from invid.refine.structure import ChainStructure
from invid.refine.whitening import factored, orthonormal, stack, unstack, unwhitener, whitener

PASSES = 12
"""Most steps of inner motion and the forces that depend on it; weak effects agree after two or three."""


@dataclass(frozen=True)
class Term:
    """An effect at a place."""

    effect: Effect
    place: Place

    @property
    def size(self) -> int:
        """Length of its parameter vector."""
        return len(self.effect.coefficients) + len(self.effect.shapes)

    @property
    def inner(self) -> bool:
        """Whether it depends on inner motion, which forces change."""
        return self.place.kind in ("spring", "pair") or (self.place.kind == "mass" and self.place.number > 1)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Effects with their parameter vectors."""

    terms: tuple[Term, ...] = ()
    x: tuple[Float64, ...] = ()

    def plus(self, term: Term, x: Float64) -> Candidate:
        """One effect more."""
        return Candidate((*self.terms, term), (*self.x, np.asarray(x, dtype=float)))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residual and what it is made of, per record."""

    residual: Float64
    jacobian: Float64
    cost: float
    missing: tuple[Complex128, ...]
    """(F, M) missing torque r of every record, boundary terms taken out."""
    covariance: tuple[Complex128, ...]
    views: tuple[View, ...]
    bases: tuple[Float64, ...] = field(default=())
    roots: tuple[Complex128, ...] = field(default=())
    dof: int = 0

    @property
    def records(self) -> list[Record]:
        """The records it is of."""
        return [view.record for view in self.views]


def views_of(layout: Layout, records: Sequence[Record], p: Float64) -> list[View]:
    """Every record through the plant at ``p``."""
    structure = layout.structure
    sp = p[: structure.count]
    values = structure.physical(sp)
    plants: dict[bytes, tuple[Complex128, Complex128, Complex128]] = {}
    out = []
    for record in records:
        key = record.omega.tobytes()
        if key not in plants:
            plants[key] = condense_dense(structure, sp, record.omega)
        motion, stiffness, inner = plants[key]
        out.append(
            View(
                record,
                structure,
                motion,
                stiffness,
                inner,
                acting_of(record, layout, p)[0],
                values[structure.slices["spring"]],
                values[structure.slices["damper"]],
                values[structure.slices["mass"]],
                layout.origin,
            )
        )
    return out


def contributions(
    view: View, candidate: Candidate, *, passes: int = PASSES, early: bool = True
) -> Complex128:
    """(F, M) of all effects, inner motion brought into agreement with the forces.

    ``early``: stop as soon as it is; otherwise a fixed number of steps along what is known, for differences.
    """
    if not candidate.terms:
        return np.zeros_like(view.acting)
    inner = any(t.inner for t in candidate.terms)
    patterns = tuple(
        t.place.pattern(view.structure)
        for t in candidate.terms
        if t.place.kind != "axis" and t.effect.along_pattern
    )

    def forces() -> tuple[Complex128, Complex128]:
        total: Complex128 = np.zeros_like(view.acting)
        back: Complex128 = np.zeros_like(view.base)
        for term, x in zip(candidate.terms, candidate.x, strict=True):
            own, yields = term.effect.contribution(view, term.place, x.tolist())
            total = total + own
            if yields is not None:
                back = back + yields
        if inner and view.missing is not None and patterns:
            back = back + view.correction(patterns, view.missing + total)
        return total, back

    if not inner:
        return forces()[0]
    return settled(view, forces, passes, early=early)


def evaluate(
    layout: Layout,
    records: Sequence[Record],
    p: Float64,
    candidate: Candidate,
    *,
    jacobian: bool = True,
    near: Sequence[View] = (),
    thorough: bool = False,
) -> Evaluation:
    """Whitened residual (rows,) and Jacobian (rows, parameters of layout, then of the effects).

    ``near``: the views of an evaluation close by, whose inner motion is where this one's starts.
    ``thorough``: the Jacobian knows that strong effects feel what the linear parameters do to inner motion.
    """
    structure = layout.structure
    views = views_of(layout, records, p)
    effects = sum(t.size for t in candidate.terms)
    residuals: list[Float64] = []
    missing: list[Complex128] = []
    jacobians, covariances, bases, roots = [], [], [], []
    dof = 0
    for view in views:
        record = view.record
        _, factor, by_stair, by_hold = acting_of(record, layout, p)
        r: Complex128 = np.einsum("fij,fj->fi", view.stiffness, record.position) - view.acting
        covariance = noise_of(view, factor, candidate)
        if near and candidate.terms:
            view.respond(near[len(missing)].feedback)
            view.secants = near[len(missing)].secants
        view.certainty = np.asarray(np.linalg.inv(covariance), dtype=np.complex128)
        root = whitener(covariance)
        if record.weight.size:
            root = root * record.weight[:, None, None]
        basis, jumps = np.zeros((0, 0)), np.zeros(0)
        moved = np.zeros((0, 0, 0), dtype=complex)
        if record.transient:
            edges, forces, points = _boundary(view, layout, p)
            moved = _moved(view, forces, points)
            jumping, yielding = _of_jumps(view, candidate, moved)
            open_ = stack(root @ (edges + jumping))
            basis, back = factored(open_)
            if near and candidate.terms:
                view.ends_of(near[len(missing)])
        else:
            view.missing = r
        linear = r
        # Laws of inner motion feel what the ends of a record do, which is known once their forces are.
        for again in (False, True):
            extra = contributions(view, candidate)
            r = linear + extra
            white = stack(root @ r[..., None])[:, 0]
            if not record.transient or again:
                break
            inner = moved - view.motion @ _shifts(structure, points) + yielding
            likely = _likely(view, open_, white)
            view.ended(inner @ likely, likely)
            if near or not any(t.inner for t in candidate.terms):
                break
        if record.transient:
            within = basis.T @ white
            along = basis @ within
            white = white - along
            r = r - unstack(unwhitener(root), along, r.shape)
            jumps = -(back @ within)
            view.of_ends = (moved + yielding) @ jumps
        view.remaining = r
        columns: Complex128 | None = None
        if jacobian:
            columns = np.zeros((*r.shape, layout.count + effects), dtype=complex)
            gain = np.linalg.solve(covariance, r[..., None])[..., 0]
            motors = structure.motors
            noise = record.noise
            # Only the sensors' noise moves the measurement: the scatter's share is in ``covariance``.
            position = record.position - noise[:, :motors] * np.einsum(
                "fij,fi->fj", view.stiffness.conj(), gain
            )
            q = np.einsum("fqm,fm->fq", view.motion, position) + view.feedback + view.of_ends
            sp = p[: structure.count]
            columns[..., : structure.count] = structure.torque_derivative(
                sp, record.omega, view.motion, q[None]
            )[0]
            if jumps.size:
                columns[..., : structure.count] += end_derivative(
                    structure, sp, record.omega, view.motion, jumps, record.span
                )
            at = structure.count
            passed = _passed(view, candidate)
            later = 1j * record.omega[:, None] * view.acting * passed
            for k, i in enumerate(layout.free_delays):
                columns[:, i, at + k] = later[:, i]
            at += len(layout.free_delays)
            for k, i in enumerate(layout.free_stairs):
                columns[:, i, at + k] = -by_stair[:, i] * passed[:, i]
                if i in layout.held_late and record.command is None:
                    columns[:, i, at + k] += 0.5 * layout.step * later[:, i]
            at += len(layout.free_stairs)
            for k, hold in enumerate(layout.holds):
                columns[:, hold.axis, at + k] = -by_hold[:, k] * passed[:, hold.axis]
            at += len(layout.holds)
            _effect_columns(view, candidate, extra, columns, at)
            if jumps.size:
                _jump_columns(view, candidate, moved, jumps, columns, at)
            if thorough and _strong(view, candidate):
                _law_columns(view, candidate, sp, q, columns, layout.count)
        residuals.append(white)
        bases.append(basis)
        roots.append(root)
        if columns is not None:
            part = stack(root @ columns)
            if record.transient:
                part = part - basis @ (basis.T @ part)
            jacobians.append(part)
        missing.append(r)
        covariances.append(covariance)
        lines = int(record.weight.sum()) if record.weight.size else record.omega.size
        dof += 2 * lines * structure.motors - structure.motors - basis.shape[1]
    priors, prior_rows = priors_of(layout, p, effects)
    residuals.append(priors)
    if jacobian:
        jacobians.append(prior_rows)
    residual = np.concatenate(residuals)
    return Evaluation(
        residual,
        np.concatenate(jacobians) if jacobian else np.zeros((0, 0)),
        float(residual @ residual),
        tuple(missing),
        tuple(covariances),
        tuple(views),
        tuple(bases),
        tuple(roots),
        dof,
    )


def _passed(view: View, candidate: Candidate) -> Complex128:
    """(F, M) how much of a change of the acting torque delays and lags of the actuators let through."""
    out: Complex128 = np.ones_like(view.acting)
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if isinstance(term.effect, ActuatorEffect):
            out[:, term.place.axis] += term.effect.response(view, term.place, x.tolist()) - 1.0
    return out


def _effect_columns(
    view: View, candidate: Candidate, extra: Complex128, columns: Complex128, at: int
) -> None:
    """Derivatives of the contributions by differences.

    Both sides take the same steps from the same inner motion: what the steps have not brought into agreement
    yet would be divided by the difference.
    """
    feedback = view.feedback
    inner = any(t.inner for t in candidate.terms)

    def at_(trial: Candidate) -> Complex128:
        out = contributions(view, trial, passes=3, early=False)
        if inner:
            view.respond(feedback)
        return out

    reference = at_(candidate) if inner else extra
    for number, (term, x) in enumerate(zip(candidate.terms, candidate.x, strict=True)):
        for k in range(x.size):
            h = _step_of(term, x, k)
            moved = x.copy()
            moved[k] += h
            changed = Candidate(candidate.terms, (*candidate.x[:number], moved, *candidate.x[number + 1 :]))
            columns[..., at] = (at_(changed) - reference) / h
            at += 1


def _of_jumps(view: View, candidate: Candidate, moved: Complex128) -> tuple[Complex128, Complex128]:
    """(F, M, 2ΣN) missing torque and (F, ΣN, 2ΣN) motion for a unit jump of each coordinate.

    Those of effects that are linear in motion; ``moved`` is what the jumps alone stand for.
    """
    torque = np.zeros((*view.acting.shape, moved.shape[-1]), dtype=complex)
    motion = np.zeros_like(moved)
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if isinstance(term.effect, ImpedanceEffect):
            pattern = term.place.pattern(view.structure)
            force = term.effect.of_jumps(view, term.place, x.tolist(), moved)[:, None, :]
            torque += view.push(pattern)[:, :, None] * force
            motion -= view.yields(pattern)[:, :, None] * force
    return torque, motion


def _jump_columns(
    view: View, candidate: Candidate, moved: Complex128, jumps: Float64, columns: Complex128, at: int
) -> None:
    """Adds to the effects' columns what they do at the ``jumps`` (2ΣN,) of a record that does not close."""
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        for k in range(x.size):
            if isinstance(term.effect, ImpedanceEffect):
                h = _step_of(term, x, k)
                more = x.copy()
                more[k] += h
                one, two = (
                    _of_jumps(view, Candidate((term,), (own,)), moved)[0] @ jumps for own in (x, more)
                )
                columns[..., at] += (two - one) / h
            at += 1


def _step_of(term: Term, x: Float64, k: int) -> float:
    """Step of a parameter for differences."""
    count = len(term.effect.coefficients)
    if k < count:
        size = float(np.abs(x[:count]).max())
        return 1e-4 * size if size > 0 else 1e-9
    return 1e-4 * (1.0 if term.effect.logarithmic[k - count] else max(abs(float(x[k])), 1e-6))


def _strong(view: View, candidate: Candidate) -> bool:
    """Whether effects move inner masses by more than a hundredth of what moves along one of their patterns:
    below, what the laws gain by a change of that is a hundredth of a column.

    Along the pattern and not beside the motors: a gap that is most of a spring's deflection moves the load by
    a hundredth of what the axis moves, and a fit without the term stands still far from its minimum.
    """
    for pattern in {t.place.pattern(view.structure) for t in candidate.terms if t.inner}:
        at, signs = [q for q, _ in pattern], np.array([sign for _, sign in pattern])
        base, moved = view.base[:, at] @ signs, view.feedback[:, at] @ signs
        if np.linalg.norm(moved) > 0.01 * np.linalg.norm(base):
            return True
    return False


def _law_columns(
    view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128, linear: int
) -> None:
    """Adds to the linear parameters' columns what the laws change by with the inner motion.

    The first ``linear`` of ``columns`` (F, M, n) hold the derivatives at fixed forces,
    ∂q/∂p = −Z_ii⁻¹ (∂Z/∂p) q. What moves no inner mass, a motor's mass or the time the torque acts at, moves
    the missing torque that forces are read from.
    """
    structure, base, feedback, missing = view.structure, view.base, view.feedback, view.missing
    springs, dampers = view.springs, view.dampers
    every = np.broadcast_to(np.eye(base.shape[1], dtype=complex), view.inner.shape)
    moves = -(view.inner @ structure.torque_derivative(sp, view.omega, every, q[None])[0])
    reference = contributions(view, candidate, passes=2, early=False)
    view.respond(feedback)
    for k in range(linear):
        largest = float(np.abs(moves[..., k]).max()) if k < structure.count else 0.0
        own = float(np.abs(columns[..., k]).max())
        if largest > 0.0:
            h = 1e-4 * float(np.abs(base).max()) / largest
            at = sp.copy()
            at[k] += h
            values = structure.physical(at)
            view.base = base + h * moves[..., k]
            view.springs = values[structure.slices["spring"]]
            view.dampers = values[structure.slices["damper"]]
        elif missing is not None and own > 0.0:
            h = 1e-4 * float(np.abs(view.acting).max()) / own
            view.base, view.springs, view.dampers = base, springs, dampers
        else:
            continue
        view.missing = None if missing is None else missing + h * columns[..., k]
        view.respond(feedback)
        columns[..., k] += (contributions(view, candidate, passes=2, early=False) - reference) / h
    view.base, view.missing, view.springs, view.dampers = base, missing, springs, dampers
    view.respond(feedback)


def noise_of(view: View, factor: Complex128, candidate: Candidate | None = None) -> Complex128:
    """(F, M, M) covariance of r; a sensor whose scale is wrong shows its noise at that scale.

    Without that, of two scales that fit alike the one that makes the noise appear larger would win.
    """
    record = view.record
    motors = record.torque.shape[1]
    noise = record.noise
    for term, x in () if candidate is None else zip(candidate.terms, candidate.x, strict=True):
        position, torque = term.effect.noise_power(view, term.place, x.tolist())
        if (position, torque) != (1.0, 1.0):
            noise = noise.copy()
            noise[:, term.place.axis] *= position
            noise[:, motors + term.place.axis] *= torque
    z = view.stiffness
    covariance: Complex128 = np.einsum("fij,fj,fkj->fik", z, noise[:, :motors], z.conj())
    index = np.arange(motors)
    covariance[:, index, index] += np.abs(factor) ** 2 * noise[:, motors:]
    covariance[:, index, index] += record.scatter
    return covariance


def _boundary(view: View, layout: Layout, p: Float64) -> tuple[Complex128, Complex128, Complex128]:
    """(F, M, 2ΣN) missing torque for a unit jump of each coordinate's position and velocity, 0 Hz first.

    Also the forces (F, ΣN, 2ΣN) and the motors' end points (F, 2) that it comes from.
    """
    structure, record = layout.structure, view.record
    forces = end_forces(structure, p[: structure.count], view.omega, record.span)
    forces[0] *= 0.5
    points = end_points(view.omega, record.step, record.span, ends_in=record.ends_in)
    points[0] = 0.0  # positions carry no mean here
    return end_columns(structure, view.motion, view.stiffness, forces, points), forces, points


def _moved(view: View, forces: Complex128, points: Complex128) -> Complex128:
    """(F, ΣN, 2ΣN) motion of every coordinate besides that of the motors' sampled spectra, for a unit."""
    moved: Complex128 = view.motion @ _shifts(view.structure, points) - view.inner @ forces
    return moved


def _shifts(structure: ChainStructure, points: Complex128) -> Complex128:
    """(F, M, 2ΣN) what the motors' end ``points`` (F, 2) add to their sampled spectra, for a unit jump."""
    motors = structure.motors
    out = np.zeros((points.shape[0], motors, 2 * structure.dofs), dtype=complex)
    at_position, at_speed = end_places(structure).reshape(2, -1)
    out[:, np.arange(motors), at_position] = points[:, :1]
    out[:, np.arange(motors), at_speed] = points[:, 1:]
    return out


def _likely(view: View, columns: Float64, white: Float64) -> Float64:
    """(2ΣN,) jumps that leave least of ``white`` and are no larger than the motion itself.

    Those that the motors hardly feel would else be noise many times the motion that laws are read from.
    """
    size = np.sqrt((np.abs(view.base) ** 2).sum(axis=0))
    rate = np.sqrt((np.abs(view.omega[:, None] * view.base) ** 2).sum(axis=0))
    scale = 2.0 * np.concatenate((size, rate)) + 1e-300
    scaled = columns * scale
    inverse = np.linalg.inv(scaled.T @ scaled + np.eye(scale.size))
    out: Float64 = -scale * (inverse @ (scaled.T @ white))
    return out


def without_boundary(
    view: View, layout: Layout, p: Float64, r: Complex128, covariance: Complex128
) -> tuple[Complex128, float]:
    """(P, F, M) ``r`` of lines 1…F of P periods without what the motion between their ends explains.

    A period of a motion that still settles does not close: its ends jump, each period's in its own way.
    Also the share of each period's numbers that is left as degrees of freedom.
    """
    root = whitener(covariance)
    basis = orthonormal(stack(root @ _boundary(view, layout, p)[0][1:]))
    back = unwhitener(root)
    out = r.copy()
    for period in out:
        ends = basis @ (basis.T @ stack(root @ period[..., None])[:, 0])
        period -= unstack(back, ends, period.shape)
    return out, 1.0 - basis.shape[1] / (2.0 * r[0].size)


__all__ = [
    "Candidate",
    "Evaluation",
    "Term",
    "contributions",
    "evaluate",
    "noise_of",
    "views_of",
    "without_boundary",
]
