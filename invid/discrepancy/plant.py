"""The linear plant with effects, fitted jointly to the missing torque of all records.

r = Z Θ − A T + Σ contributions, whitened with C_r = [Z, −A] C_n [Z, −A]ᴴ times what the scatter between
periods adds. The Jacobian of the linear parameters is taken at the projected measurement (the cost's
gradient is then exact for errors in variables); that of effects by differences, which costs one
evaluation of the effect and no new plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from invid.arrays import Bool, Complex128, Float64
from invid.discrepancy.holds import HeldInside
from invid.discrepancy.inner import settled
from invid.effects.base import Effect, Place, Record, View
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
class Layout:
    """The parameter vector: structure, delay of each axis, share held over the sample of each axis, share of
    each hold that works inside its drive."""

    structure: ChainStructure
    step: float
    free_stairs: tuple[int, ...]
    known_stairs: Float64
    free_delays: tuple[int, ...]
    origin: float
    delayed: tuple[int, ...] = ()
    """Axes whose delay is an effect's."""
    holds: tuple[HeldInside, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        axes = self.structure.axes
        return (
            *self.structure.names,
            *(f"{axes[i]}.time_offset" for i in self.free_delays),
            *(f"{axes[i]}.held_over_sample" for i in self.free_stairs),
            *(f"{axes[h.axis]}.{h.name}" for h in self.holds),
        )

    @property
    def count(self) -> int:
        """n."""
        return self.structure.count + len(self.free_delays) + len(self.free_stairs) + len(self.holds)

    @property
    def stairs_at(self) -> slice:
        """Where the shares held over the sample stand."""
        first = self.structure.count + len(self.free_delays)
        return slice(first, first + len(self.free_stairs))

    @property
    def holds_at(self) -> slice:
        """Where the shares of the holds stand."""
        return slice(self.stairs_at.stop, self.count)

    def delays(self, p: Float64) -> Float64:
        """(M,) [s]."""
        out = np.zeros(self.structure.motors)
        at = self.structure.count
        out[list(self.free_delays)] = p[at : at + len(self.free_delays)]
        return out

    @property
    def held_late(self) -> tuple[int, ...]:
        """Axes with a delay of an effect whose measured torque may be held over its sample.

        Holding acts half a sample late, which a free time offset takes up; beside a delay that is an effect's
        it stands for itself, or the effect would be half a sample too long. Where the torque is the recorded
        demand itself, the effect is how late it follows its command, holding included.
        """
        return tuple(i for i in self.delayed if i in self.free_stairs)

    def lateness(self, p: Float64, record: Record) -> Float64:
        """(M,) how much later than recorded the torque acts [s], effects apart."""
        out = self.delays(p)
        if self.held_late and record.command is None:  # a demand beside a hold has its half sample of its own
            at = list(self.held_late)
            out[at] += 0.5 * self.step * self.stairs(p)[at]
        return out

    def stairs(self, p: Float64) -> Float64:
        """(M,) share of the torque that is held over each sample."""
        out = self.known_stairs.copy()
        out[list(self.free_stairs)] = p[self.stairs_at]
        return out

    def without_delay(self, axes: Sequence[int]) -> tuple[Layout, Bool]:
        """The layout with some axes' delays left to effects, and which parameters stay."""
        kept = tuple(i for i in self.free_delays if i not in axes)
        stay = np.ones(self.count, dtype=bool)
        for k, i in enumerate(self.free_delays):
            if i in axes:
                stay[self.structure.count + k] = False
        delayed = tuple(sorted({*self.delayed, *axes}))
        return replace(self, free_delays=kept, delayed=delayed), stay


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
                _acting(record, layout, p)[0],
                values[structure.slices["spring"]],
                values[structure.slices["damper"]],
                values[structure.slices["mass"]],
                layout.origin,
            )
        )
    return out


def _acting(
    record: Record, layout: Layout, p: Float64
) -> tuple[Complex128, Complex128, Complex128, Complex128]:
    """Torque that acts (F, M), factor A, its derivative by the stairs, and by each hold's share (F, holds).

    Holding a sample takes amplitude away and acts half a sample late. The time offset takes up the
    latter where all torque is alike. Where the demand is logged beside a hold, the demand is held over
    the sample (the contract says so) and ``stairs`` is the share of the rest that is.
    """
    w = record.omega
    delays, stairs = layout.lateness(p, record), layout.stairs(p)
    smear = (1.0 - np.sinc(w * record.step / 2 / np.pi))[:, None]
    z = np.exp(-1j * w[:, None] * delays)
    factor = z * (1.0 - stairs * smear)
    by_hold = np.zeros((w.size, len(layout.holds)), dtype=complex)
    if record.command is None:
        acting = factor * record.torque
        by_stair = -z * smear * record.torque
        for k, (hold, share) in enumerate(zip(layout.holds, p[layout.holds_at], strict=True)):
            i = hold.axis
            if record.key not in hold.records:
                continue
            # Command E = T + HΘ and hold −HΘ act at different times: A·T + (A − z₂)·H·Θ, z₂ half a sample
            # earlier and not held over it.
            torque = hold.law(w) * record.position[:, i]
            by_hold[:, k] = (factor[:, i] - z[:, i] * np.exp(0.5j * w * record.step)) * torque
            acting[:, i] += share * by_hold[:, k]
            by_stair[:, i] -= share * (z * smear)[:, i] * torque
        return acting, factor, by_stair, by_hold
    rest = record.torque - record.command
    held = ((1.0 - smear) * np.exp(-0.5j * w * record.step)[:, None]).astype(complex)
    acting = z * (record.command * held + rest * (1.0 - stairs + stairs * held))
    return acting, factor, z * (held - 1.0) * rest, by_hold


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
        _, factor, by_stair, by_hold = _acting(record, layout, p)
        r: Complex128 = np.einsum("fij,fj->fi", view.stiffness, record.position) - view.acting
        covariance = noise_of(view, factor, candidate)
        if near and candidate.terms:
            view.respond(near[len(missing)].feedback)
            view.secants = near[len(missing)].secants
        view.certainty = np.asarray(np.linalg.inv(covariance), dtype=np.complex128)
        if not record.transient:
            view.missing = r
        extra = contributions(view, candidate)
        r = r + extra
        root = whitener(covariance)
        if record.weight.size:
            root = root * record.weight[:, None, None]
        basis = np.zeros((0, 0))
        white = stack(root @ r[..., None])[:, 0]
        ends: _Ends | None = None
        if record.transient:
            edges, forces, points = _boundary(view, layout, p)
            basis, back = factored(stack(root @ edges))
            within = basis.T @ white
            along = basis @ within
            white = white - along
            r = r - unstack(unwhitener(root), along, r.shape)
            if jacobian:
                ends = _Ends.of(-(back @ within), forces, points, structure)
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
            if ends is not None:
                position = position + ends.shift
            q = np.einsum("fqm,fm->fq", view.motion, position) + view.feedback
            if ends is not None:
                q = q - np.einsum("fab,fb->fa", view.inner, ends.force)
            sp = p[: structure.count]
            columns[..., : structure.count] = structure.torque_derivative(
                sp, record.omega, view.motion, q[None]
            )[0]
            if ends is not None:
                columns[..., : structure.count] += end_derivative(
                    structure, sp, record.omega, view.motion, ends.jumps, record.span
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
            if thorough and _strong(view, candidate):
                _law_columns(view, candidate, sp, q, columns)
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
    priors, prior_rows = _priors(layout, p, effects)
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


def _priors(layout: Layout, p: Float64, effects: int) -> tuple[Float64, Float64]:
    """Torque is held over the sample (1), continuous (0), or smoothed in between; so is that of a hold."""
    first, last = layout.stairs_at.start, layout.count
    expected = np.array([0.5] * len(layout.free_stairs) + [h.expected for h in layout.holds])
    rows = np.zeros((last - first, layout.count + effects))
    rows[:, first:last] = 2.0 * np.eye(last - first)
    return 2.0 * (p[first:last] - expected), rows


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
        count = len(term.effect.coefficients)
        for k in range(x.size):
            if k < count:
                size = float(np.abs(x[:count]).max())
                h = 1e-4 * size if size > 0 else 1e-9
            else:
                h = 1e-4 * (1.0 if term.effect.logarithmic[k - count] else max(abs(float(x[k])), 1e-6))
            moved = x.copy()
            moved[k] += h
            changed = Candidate(candidate.terms, (*candidate.x[:number], moved, *candidate.x[number + 1 :]))
            columns[..., at] = (at_(changed) - reference) / h
            at += 1


def _strong(view: View, candidate: Candidate) -> bool:
    """Whether effects move inner masses by more than a hundredth of what the motors move: below, what they
    gain by a change of that is a hundredth of a column."""
    moved = float(np.abs(view.feedback).max())
    return any(t.inner for t in candidate.terms) and moved > 0.01 * float(np.abs(view.base).max())


def _law_columns(view: View, candidate: Candidate, sp: Float64, q: Complex128, columns: Complex128) -> None:
    """Adds to the linear parameters' columns what the laws change by with the inner motion.

    ``columns`` (F, M, n) holds the derivatives at fixed forces, ∂q/∂p = −Z_ii⁻¹ (∂Z/∂p) q.
    """
    structure, base, feedback, missing = view.structure, view.base, view.feedback, view.missing
    springs, dampers = view.springs, view.dampers
    every = np.broadcast_to(np.eye(base.shape[1], dtype=complex), view.inner.shape)
    moves = -(view.inner @ structure.torque_derivative(sp, view.omega, every, q[None])[0])
    reference = contributions(view, candidate, passes=2, early=False)
    view.respond(feedback)
    for k in range(structure.count):
        largest = float(np.abs(moves[..., k]).max())
        if largest == 0.0:
            continue
        h = 1e-4 * float(np.abs(base).max()) / largest
        at = sp.copy()
        at[k] += h
        values = structure.physical(at)
        view.base = base + h * moves[..., k]
        view.missing = None if missing is None else missing + h * columns[..., k]
        view.springs, view.dampers = values[structure.slices["spring"]], values[structure.slices["damper"]]
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


@dataclass(frozen=True, eq=False)
class _Ends:
    """What the ends of a record that does not close do, at the jumps that fit best."""

    jumps: Float64
    """(2ΣN,) of every coordinate's position, then velocity."""
    force: Complex128
    """(F, ΣN) on every coordinate."""
    shift: Complex128
    """(F, M) of the motors' sampled spectra to their integrals."""

    @classmethod
    def of(cls, jumps: Float64, forces: Complex128, points: Complex128, structure: ChainStructure) -> _Ends:
        """From the ``jumps`` (2ΣN,), the forces and the end points for a unit of each."""
        shift = points @ jumps[end_places(structure)].reshape(2, -1)
        return cls(jumps, forces @ jumps, shift)


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
    "Layout",
    "Term",
    "contributions",
    "evaluate",
    "noise_of",
    "views_of",
    "without_boundary",
]
