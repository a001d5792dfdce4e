"""Shapes of laws and of friction, moved together with all numbers: Gauss and Newton with each shape's own
column."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.effects.supposed.law import Shape
from invid.likelihood.unknown_forces.descent import TO_END
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis, Hypothesis
from invid.likelihood.unknown_forces.motions import PlacedLaw, vector_of
from invid.likelihood.unknown_forces.motor_laws import FrictionShape, Part
from invid.likelihood.unknown_forces.slope import number_rows, whitened_rows
from invid.likelihood.unknown_forces.value import along, evaluate
from invid.model.plant import Structure
from invid.numerics import budget
from invid.numerics.arrays import Complex128, Float64, Int64

SMOOTHED = 2
"""Times that a law's motion is smoothed beside its shape before it is compared."""
LARGEST = 0.5
"""Largest step of a shape's logarithm."""
WIDTH_BOUNDS, STRIBECK_BOUNDS = (3e-5, 0.1), (0.01, 8.0)
"""Bounds of a width and a Stribeck velocity over the motor's rms velocity."""
APART = 4.0
"""Least Stribeck velocity over the width of dry friction's turn: closer to it a rise at slow speed is the
form of the turn (physical: at four widths tanh has turned)."""
NO_POWER = 1e-140
"""Beside the size of a column: a shape of a law that is not there has none, and its variance stays finite."""
FALL = 0.5
"""Predicted fall of −2 ln L below which shapes stay."""
FRICTION_STEP, LEAD_STEP = 0.05, 0.01
SHARE_OF_RANGE = 0.01
"""Largest step of a shape for its derivative, over the range between its bounds."""
LATEST_LEAD = 0.4
"""Largest lead of dry friction's turn in periods of the highest line: beyond it friction would follow the
acceleration alone. A turn that lags is presliding, a cause of its own."""


@dataclass(frozen=True)
class ShapeAt:
    """One shape of a hypothesis: whose it is, where it stands, its bounds, its derivative."""

    name: Hashable
    get: Callable[[Hypothesis], float]
    put: Callable[[Hypothesis, float], Hypothesis]
    slope: Callable[[FittedHypothesis], list[Complex128]]
    """(R, F) of each stack: change of the law's force by the shape."""
    vector: Float64
    low: float
    high: float


def shapes_of(now: FittedHypothesis) -> list[ShapeAt]:
    """All shapes of friction and laws that have a force."""
    out: list[ShapeAt] = []
    structure = now.hypothesis.structure
    coefficients = now.fit.value.coefficients
    names = [c.name for c in now.fit.problem.columns]
    speed = _speeds(now)
    unit = np.eye(structure.coordinates)
    for motor in range(structure.motors):
        dry = coefficients[names.index((Part.DRY, motor))]
        rise = coefficients[names.index((Part.RISE, motor))]
        vector = unit[structure.motor[motor]]
        if dry or rise:
            low, high = (b * speed[motor] for b in WIDTH_BOUNDS)
            high = min(high, now.hypothesis.friction[motor].stribeck / APART) if rise else high
            out.append(_friction_shape(motor, "width", vector, _logs(min(low, high), high)))
            top = max(r.top_hz for s in now.bench.stacks for r in s.records)
            out.append(_friction_shape(motor, "lead", vector, (0.0, LATEST_LEAD), top))
        if rise:
            low, high = (b * speed[motor] for b in STRIBECK_BOUNDS)
            low = max(low, APART * now.hypothesis.friction[motor].width)
            out.append(_friction_shape(motor, "stribeck", vector, _logs(low, max(low, high))))
    for k, placed in enumerate(now.hypothesis.laws):
        bounds = placed.law.bounds(now.motions.flat(placed.spot))
        for i, (low, high) in enumerate(bounds):
            out.append(_law_shape(now, k, i, (low, high), structure))
    return out


def _speeds(now: FittedHypothesis) -> Float64:
    records = [r for s in now.bench.stacks for r in s.records]
    out: Float64 = np.sqrt(np.mean([(r.motion.velocity**2).mean(axis=0) for r in records], axis=0))
    return out


def _logs(low: float, high: float) -> tuple[float, float]:
    return float(np.log(low)), float(np.log(high))


def _with_friction(was: Hypothesis, motor: int, shape: FrictionShape) -> Hypothesis:
    return replace(was, friction=(*was.friction[:motor], shape, *was.friction[motor + 1 :]))


def _with_shape(was: Hypothesis, number: int, shape: Shape) -> Hypothesis:
    law = replace(was.laws[number], shape=shape)
    return replace(was, laws=(*was.laws[:number], law, *was.laws[number + 1 :]))


def _central(force: Callable[[float], list[Complex128]], step: float) -> list[Complex128]:
    return [(a - b) / (2 * step) for a, b in zip(force(step), force(-step), strict=True)]


def _friction_shape(
    motor: int, name: str, vector: Float64, bounds: tuple[float, float], times: float = 0.0
) -> ShapeAt:
    """The shape as a logarithm, or where it may be zero ``times`` something."""

    def get(h: Hypothesis) -> float:
        own = float(getattr(h.friction[motor], name))
        return own * times if times else float(np.log(own))

    def put(h: Hypothesis, value: float) -> Hypothesis:
        own = value / times if times else float(np.exp(value))
        return _with_friction(h, motor, replace(h.friction[motor], **{name: own}))

    def slope(now: FittedHypothesis) -> list[Complex128]:
        at = get(now.hypothesis)
        return _central(
            lambda s: _friction_force(now, motor, put(now.hypothesis, at + s).friction[motor]),
            LEAD_STEP if times else FRICTION_STEP,
        )

    return ShapeAt((Part.DRY, motor, name), get, put, slope, vector, *bounds)


def _friction_force(now: FittedHypothesis, motor: int, shape: FrictionShape) -> list[Complex128]:
    sizes = now.sizes
    parts = [(p, sizes[p, motor]) for p in (Part.DRY, Part.RISE)]
    lines = [[size * s for s in now.bench.motor_laws.lines(motor, p, shape)] for p, size in parts if size]
    return [np.sum(stack, axis=0) for stack in zip(*lines, strict=True)]


def _law_shape(
    now: FittedHypothesis, number: int, shape: int, bounds: tuple[float, float], structure: Structure
) -> ShapeAt:
    def get(h: Hypothesis) -> float:
        return h.laws[number].shape[shape]

    def put(h: Hypothesis, value: float) -> Hypothesis:
        was = h.laws[number].shape
        return _with_shape(h, number, (*was[:shape], value, *was[shape + 1 :]))

    def slope(now: FittedHypothesis) -> list[Complex128]:
        placed, at = now.hypothesis.laws[number], get(now.hypothesis)
        first = [c.name for c in now.fit.problem.columns].index((*placed.key, 0))
        value = now.fit.value.coefficients[first : first + len(placed.law.low)]

        def force(step: float) -> list[Complex128]:
            moved = put(now.hypothesis, at + step).laws[number].shape
            return [lines @ value for lines in now.bench.law_lines(placed, now.motions, moved)]

        return _central(force, min(placed.law.shape_step, SHARE_OF_RANGE * (bounds[1] - bounds[0])))

    vector = vector_of(structure, now.hypothesis.laws[number].spot)
    return ShapeAt((number, shape), get, put, slope, vector, *bounds)


STRIBECK_GRID = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0)
WIDTH_GRID = (0.4, 1.0, 2.5)
"""Stribeck velocities over the motor's rms velocity, and widths over the present one, that are looked at."""


def scan_friction(now: FittedHypothesis) -> FittedHypothesis:
    """The same with each motor's friction at the best of a grid of shapes, numbers as they are."""
    speed = _speeds(now)
    best, hypothesis = now.total, now.hypothesis
    for motor in range(len(hypothesis.friction)):
        if budget.is_left_out(TO_END):
            break
        first = hypothesis.friction[motor]
        low, high = (b * speed[motor] for b in WIDTH_BOUNDS)
        widths = [float(np.clip(first.width * w, low, high)) for w in WIDTH_GRID]
        grid = [FrictionShape(w, s * speed[motor], first.lead) for w in widths for s in STRIBECK_GRID]
        for shape in grid:
            if shape.stribeck < APART * shape.width:
                continue
            trial = _with_friction(hypothesis, motor, shape)
            total = _total(now, trial)
            if total < best - 2.0 * FALL:
                best, hypothesis = total, trial
    return now.refit(hypothesis) if hypothesis is not now.hypothesis else now


def _total(now: FittedHypothesis, trial: Hypothesis) -> float:
    """−2 ln L with other shapes, numbers as they are."""
    problem = replace(now.fit.problem, columns=now.bench.columns(trial, now.motions))
    return evaluate(problem, now.numbers).total


def scan_law(now: FittedHypothesis, number: int) -> FittedHypothesis:
    """The same with a law's shape at the best of its grids, one after another, the numbers fitted after
    each."""
    placed = now.hypothesis.laws[number]
    motions = now.motions.flat(placed.spot)
    bounds = placed.law.bounds(motions)
    for moves in placed.law.about(motions):
        best = now.total, now.hypothesis
        for move in moves:
            moved = [np.clip(s + d, *b) for s, d, b in zip(placed.shape, move, bounds, strict=True)]
            trial = _with_shape(now.hypothesis, number, tuple(float(s) for s in moved))
            best = min(best, (_total(now, trial), trial), key=lambda b: b[0])
        now = now.refit(best[1], iterations=3)
        placed = now.hypothesis.laws[number]
    return now


def with_law(now: FittedHypothesis, placed: PlacedLaw) -> FittedHypothesis:
    """The hypothesis with one law more, its shape and all numbers at their best."""
    found = now.refit(now.hypothesis.plus(placed), iterations=5)
    found = scan_law(found, len(found.hypothesis.laws) - 1)
    return smoothed_with_shapes(found) if placed.needs_fit else reshape(found, 4)


def smoothed_with_shapes(now: FittedHypothesis) -> FittedHypothesis:
    """The same with shapes at their best and inner motion smoothed anew, in turn."""
    for _ in range(SMOOTHED):
        now = reshape(now, 2).renewed(5)
    return now if now.fit.is_finished else now.refit()


def reshape(now: FittedHypothesis, rounds: int = 4) -> FittedHypothesis:
    """The same with shapes at their best, inner motion as it is."""
    for _ in range(rounds):
        moved = _step(now)
        if moved is None:
            break
        gained, now = now.total - moved.total, moved
        if gained < 2.0 * FALL:
            break
    return now if now.fit.is_finished else now.refit()


@dataclass(frozen=True, eq=False)
class Curvature:
    """Half the gradient and the curvature of −2 ln L by the numbers, the free coefficients and the shapes."""

    gradient: Float64
    matrix: Float64
    numbers: int
    free: Int64
    shapes: tuple[ShapeAt, ...]

    @cached_property
    def covariance(self) -> Float64:
        """Joint covariance in the same order."""
        unit = np.sqrt(np.diag(self.matrix)) + NO_POWER
        scaled = self.matrix / unit[:, None] / unit + 1e-12 * np.eye(unit.size)
        return np.asarray(np.linalg.inv(scaled) / unit[:, None] / unit, dtype=np.float64)


def curvature(now: FittedHypothesis) -> Curvature:
    """The curvature at a fit, its shapes included."""
    shapes = tuple(shapes_of(now))
    value, around = now.fit.value, now.fit.slope
    columns = [shape.slope(now) for shape in shapes]
    size, count = around.gradient.size, len(shapes)
    free = np.flatnonzero(value.free)
    cross, own, pull = np.zeros((size + free.size, count)), np.zeros((count, count)), np.zeros(count)
    for k, work in enumerate(value.work if shapes else ()):
        reach = [along(work.condensed.motion, s.vector[:, None])[..., 0] for s in shapes]
        lines = [c[k][..., None] * r for c, r in zip(columns, reach, strict=True)]
        flat = whitened_rows(work, np.stack(lines, axis=-1)).reshape(-1, count)
        cross += joint_rows(now, k).T @ flat
        own += flat.T @ flat
        pull += flat.T @ (work.missing + work.laws @ value.coefficients).ravel()
    gradient = np.concatenate((around.gradient, np.zeros(free.size), pull))
    return Curvature(gradient, np.block([[around.joint, cross], [cross.T, own]]), size, free, shapes)


def _step(now: FittedHypothesis) -> FittedHypothesis | None:
    around = curvature(now)
    if not around.shapes:
        return None
    unit = np.sqrt(np.diag(around.matrix)) + 1e-300
    damped = around.matrix / unit[:, None] / unit + 1e-6 * np.eye(unit.size)
    step = -np.linalg.solve(damped, around.gradient / unit) / unit
    if -float(around.gradient @ step) < FALL:
        return None
    for share in (1.0, 0.4, 0.1):
        hypothesis = now.hypothesis
        for shape, move in zip(around.shapes, step[-len(around.shapes) :], strict=True):
            most = min(LARGEST, 0.25 * (shape.high - shape.low))
            at = shape.get(hypothesis) + share * float(np.clip(move, -most, most))
            hypothesis = shape.put(hypothesis, float(np.clip(at, shape.low, shape.high)))
        trial = now.refit(hypothesis, iterations=3)
        if trial.total < now.total:
            return trial
    return None


def joint_rows(now: FittedHypothesis, number: int) -> Float64:
    """(rows, p + J') whitened columns of the numbers and of the free laws in one stack."""
    work = now.fit.value.work[number]
    rows = number_rows(now.fit.problem, now.fit.value, number)
    free = np.flatnonzero(now.fit.value.free)
    return np.concatenate((rows, work.laws[..., free]), axis=2).reshape(-1, rows.shape[2] + free.size)
