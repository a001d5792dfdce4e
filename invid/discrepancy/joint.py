"""Joint fits of the linear parameters and of effects on the missing torque.

Columns depend on the inner motion, which depends on the parameters and on the forces themselves:
they are made anew in every round, until the cost stands. The shape of a law (a gap, a velocity) moves
with the rest through a column of its own derivative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.arrays import Complex128, Float64
from invid.discrepancy.records import Part, Problems
from invid.effects import Effect, Place, Shape
from invid.effects.motion import Context, context_of
from invid.refine.problem import MissingTorqueProblem
from invid.refine.solver import Solution, gauss_newton

SHAPE_STEP = 1e-3
"""Relative step of the shape's numerical derivative."""
SHAPE_STD = 0.3
"""Prior of one round's step of a shape's logarithm: laws are not linear in their shape beyond that."""


@dataclass(frozen=True, eq=False)
class Term:
    """An effect at a place with a shape and coefficients."""

    effect: Effect
    place: Place
    shape: Shape
    coefficients: Float64

    @property
    def key(self) -> tuple[str, int, str | None, int | None]:
        """What and where, without how much."""
        return self.effect.cause, self.place.axis, self.place.element, self.place.other

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices of the shape's continuous entries."""
        return tuple(range(self.effect.variants, len(self.shape)))


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Linear parameters and terms fitted jointly.

    ``cost`` and ``dof`` are those of training; ``held_out`` and ``held_out_dof`` of the records kept
    out, at the same parameters.
    """

    terms: tuple[Term, ...]
    problem: MissingTorqueProblem
    solution: Solution
    cost: float
    dof: int
    held_out: float
    held_out_dof: int
    converged: bool

    @property
    def known(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.problem.names, self.solution.p, strict=True))

    @property
    def parameters(self) -> int:
        """Number of parameters that effects add: coefficients and shapes."""
        return sum(
            (0 if t.effect.unit_coefficient else t.coefficients.size) + len(t.moving) for t in self.terms
        )

    @property
    def physical(self) -> bool:
        """Coefficients and shapes within their bounds."""
        return all(
            not t.effect.lower or bool(np.all(t.coefficients >= np.array(t.effect.lower))) for t in self.terms
        )


def bare(problem: MissingTorqueProblem) -> MissingTorqueProblem:
    """The problem without columns."""
    blocks = tuple(
        replace(b, columns=np.zeros((b.omega.size, b.position.shape[1], 0), dtype=complex))
        for b in problem.blocks
    )
    return replace(problem, blocks=blocks, column_names=())


def vector(problem: MissingTorqueProblem, known: dict[str, float]) -> Float64:
    """Parameters of ``problem`` by name; those not known are neutral."""
    start = problem.start(np.array([known[n] for n in problem.structure.names]))
    return np.array([known.get(n, v) for n, v in zip(problem.names, start, strict=True)])


def forces_of(context: Context, terms: Sequence[Term]) -> list[Complex128]:
    """Per record (F, ΣN): the terms' resisting forces on all coordinates."""
    out = []
    for record in context.records:
        total = np.zeros((record.index.size, context.structure.dofs), dtype=complex)
        for t in terms:
            units = t.effect.forces(context, record, t.place, t.shape)
            if units.shape[1]:
                force = units @ t.coefficients
                total[:, t.place.a] += force
                if t.place.b is not None:
                    total[:, t.place.b] -= force
        out.append(total)
    return out


def motion(
    problem: MissingTorqueProblem,
    p: Float64,
    part: Part,
    terms: Sequence[Term],
    *,
    place: tuple[int, int | None] | None = None,
    steps: int = 3,
) -> Context:
    """Motion of all coordinates under the terms' own forces (fixed point), or under what a place asks for."""
    structure = problem.structure
    states = problem.states(p)
    context = context_of(structure, p, states, part.spectra, part.spans, place=place)
    inner = [t for t in terms if t.place.inner]
    if place is not None or not inner:
        return context
    for _ in range(steps):
        forces = forces_of(context, terms)
        context = context_of(structure, p, states, part.spectra, part.spans, forces)
    return context


def columns(context: Context, terms: Sequence[Term], *, shapes: bool) -> tuple[list[Complex128], list[str]]:
    """Per record the columns (F, M, L) of all terms and their names; with derivatives by the shapes."""
    names: list[str] = []
    per_record: list[list[Complex128]] = [[] for _ in context.records]
    for number, t in enumerate(terms):
        width = 0
        for at, record in enumerate(context.records):
            own = t.effect.columns(context, record, t.place, t.shape)
            width = own.shape[2]
            per_record[at].append(own)
            for m in t.moving if shapes else ():
                shifted = list(t.shape)
                shifted[m] *= 1.0 + SHAPE_STEP
                other = t.effect.columns(context, record, t.place, tuple(shifted))
                per_record[at].append(((other - own) @ t.coefficients / SHAPE_STEP)[:, :, None])
        names += [f"{number}.{t.effect.cause}.{k}" for k in range(width)]
        names += [f"{number}.{t.effect.cause}.shape{m}" for m in (t.moving if shapes else ())]
    return [np.concatenate(c, axis=2) for c in per_record], names


def loaded(
    problem: MissingTorqueProblem, context: Context, terms: Sequence[Term], *, shapes: bool
) -> MissingTorqueProblem:
    """The bare problem with the terms' columns; coefficients that are 1 by definition are fixed there."""
    plain = bare(problem)
    if not terms:
        return plain
    values, names = columns(context, terms, shapes=shapes)
    blocks = tuple(replace(b, columns=c) for b, c in zip(plain.blocks, values, strict=True))
    priors = dict(plain.priors)
    fixed = list(plain.fixed)
    for number, t in enumerate(terms):
        start = f"{number}.{t.effect.cause}."
        if t.effect.unit_coefficient:
            priors[start + "0"] = (1.0, 1e-9)
            fixed.append(start + "0")
        for m in t.moving if shapes else ():
            priors[f"{start}shape{m}"] = (0.0, SHAPE_STD)
    return replace(plain, blocks=blocks, column_names=tuple(names), priors=priors, fixed=tuple(fixed))


def _stepped(terms: Sequence[Term], known: dict[str, float]) -> tuple[Term, ...]:
    """Terms with the coefficients found and the shapes moved."""
    out = []
    for number, t in enumerate(terms):
        start = f"{number}.{t.effect.cause}."
        coefficients = np.array([known[f"{start}{k}"] for k in range(t.coefficients.size)])
        shape = list(t.shape)
        for m in t.moving:
            step = known.get(f"{start}shape{m}", 0.0)
            shape[m] *= float(np.exp(np.clip(step, -0.5, 0.5)))
        out.append(replace(t, coefficients=coefficients, shape=tuple(shape)))
    return tuple(out)


def fit(
    problems: Problems,
    terms: Sequence[Term],
    known: dict[str, float],
    *,
    rounds: int = 8,
    give_up: float = np.inf,
) -> Hypothesis:
    """The terms and all linear parameters, fitted jointly from ``known``.

    ``give_up``: stop after two rounds where the cost is still above it.
    """
    train, part = problems.train, problems.records.train
    current = tuple(terms)
    if not current:
        plain = bare(train)
        return _judged(problems, (), plain, gauss_newton(plain, vector(plain, known)), known, True)
    best: Hypothesis | None = None
    last, converged = np.inf, False
    for turn in range(rounds):
        plain = bare(train)
        start = vector(plain, known)
        # The first inner motion is the one the missing torque itself asks for at the newest place.
        newest = current[-1].place
        guess = (newest.a, newest.b) if turn == 0 and newest.inner and len(current) == 1 else None
        context = motion(plain, start, part, current, place=guess)
        problem = loaded(plain, context, current, shapes=True)
        given = dict(known)
        for number, t in enumerate(current):
            prefix = f"{number}.{t.effect.cause}."
            given |= {f"{prefix}{k}": float(v) for k, v in enumerate(t.coefficients)}
        solution = gauss_newton(problem, vector(problem, given), iterations=12)
        found = dict(zip(problem.names, solution.p, strict=True))
        known = {n: v for n, v in found.items() if n in set(plain.names)}
        current = _stepped(current, found)
        scale = max(solution.reduced, 1.0)
        if best is None or solution.chi2 < best.cost:
            best = Hypothesis(current, problem, solution, solution.chi2, solution.dof, np.nan, 0, False)
        if abs(last - solution.chi2) < 0.05 * scale:
            converged = True
            break
        if turn >= 1 and solution.chi2 > give_up:
            break
        last = solution.chi2
    if best is None:
        raise ValueError("fit needs at least one round")
    known = {n: v for n, v in best.known.items() if n in set(plain.names)}
    return _judged(problems, best.terms, best.problem, best.solution, known, converged)


def _judged(
    problems: Problems,
    terms: tuple[Term, ...],
    problem: MissingTorqueProblem,
    solution: Solution,
    known: dict[str, float],
    converged: bool,
) -> Hypothesis:
    cost, count = held_out_cost(problems, terms, dict(zip(problem.names, solution.p, strict=True)))
    return Hypothesis(terms, problem, solution, solution.chi2, solution.dof, cost, count, converged)


def held_out_problem(
    problems: Problems, terms: Sequence[Term], known: dict[str, float]
) -> tuple[MissingTorqueProblem, Float64]:
    """The held-out problem with the terms' columns, and the parameters found in training."""
    plain = bare(problems.held_out)
    start = vector(plain, known)
    if not terms:
        return plain, start
    context = motion(plain, start, problems.records.held_out, terms)
    problem = replace(loaded(plain, context, terms, shapes=False), priors={}, fixed=())
    given = dict(known)
    for number, t in enumerate(terms):
        prefix = f"{number}.{t.effect.cause}."
        given |= {f"{prefix}{k}": float(v) for k, v in enumerate(t.coefficients)}
    return problem, vector(problem, given)


def held_out_cost(problems: Problems, terms: Sequence[Term], known: dict[str, float]) -> tuple[float, int]:
    """χ² of the held-out records at the parameters found in training, and its degrees of freedom."""
    if not problems.held_out.blocks:
        return np.nan, 0
    problem, p = held_out_problem(problems, terms, known)
    residual, _ = problem.evaluate(p)
    rows = sum(2 * b.position.size for b in problem.blocks)
    rows -= sum(2 * problems.structure.dofs for b in problem.blocks if b.transient)
    return float(residual @ residual), rows
