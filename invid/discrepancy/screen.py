"""Score tests: how much of the missing torque each cause at each place would take away.

Linear parameters and the causes already chosen are projected out; milliseconds a cause. Inner motions
are those under the force that the missing torque itself asks for at the place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear, minimize_scalar

from invid.arrays import Complex128, Float64
from invid.discrepancy.joint import Hypothesis, Term, bare, motion, vector
from invid.discrepancy.records import Problems
from invid.effects import CATALOGUE, Effect, Place, Shape
from invid.effects.motion import Context, context_of
from invid.refine.problem import State, _stack, _whitener


@dataclass(frozen=True, eq=False)
class Score:
    """``gain``: training cost removed by ``term``, to first order; ``tried``: shapes looked at."""

    term: Term
    gain: float
    tried: int


class Screen:
    """Score tests around one hypothesis."""

    def __init__(self, problems: Problems, around: Hypothesis) -> None:
        self._problems = problems
        self._around = around
        problem, p = around.problem, around.solution.p
        self._residual, jacobian = problem.evaluate(p)
        scale = np.linalg.norm(jacobian, axis=0)
        self._basis = np.linalg.qr(jacobian[:, scale > 0] / scale[scale > 0])[0]
        self._states = problem.states(p)
        self._roots = [_whitener(s.covariance) for s in self._states]
        self._boundary = [_basis_of(s, root) for s, root in zip(self._states, self._roots, strict=True)]
        self._left = self._residual - self._basis @ (self._basis.T @ self._residual)
        self.cost = float(self._left @ self._left)
        self._contexts: dict[tuple[int, int | None] | None, Context] = {}

    def all_scores(self, *, exclude: frozenset[tuple[str, int, str | None, int | None]]) -> list[Score]:
        """Every cause at every place, the best shape of each, best first."""
        scores = []
        for effect in CATALOGUE:
            for place in effect.places(self._problems.structure):
                if (effect.cause, place.axis, place.element, place.other) not in exclude:
                    scores.append(self._best(effect, place))
        return sorted(scores, key=lambda s: -s.gain)

    def _context(self, place: Place) -> Context:
        key = (place.a, place.b) if place.inner else None
        if key not in self._contexts:
            part = self._problems.records.train
            if key is None or not self._around.terms:
                self._contexts[key] = context_of(
                    self._problems.structure,
                    self._around.solution.p,
                    self._states,
                    part.spectra,
                    part.spans,
                    place=key,
                )
            else:
                # Beside chosen terms: their forces move the inner coordinates first.
                plain = bare(self._problems.train)
                p = vector(plain, self._around.known)
                with_terms = motion(plain, p, part, self._around.terms)
                self._contexts[key] = with_terms
        return self._contexts[key]

    def _white(self, columns: list[Complex128]) -> Float64:
        rows = []
        for c, root, basis in zip(columns, self._roots, self._boundary, strict=True):
            x = _stack(root @ c)
            rows.append(x if basis is None else x - basis @ (basis.T @ x))
        x = np.concatenate(rows)
        x = np.concatenate((x, np.zeros((self._residual.size - x.shape[0], x.shape[1]))))
        left: Float64 = x - self._basis @ (self._basis.T @ x)
        return left

    def _gain(self, effect: Effect, place: Place, shape: Shape) -> tuple[float, Float64]:
        context = self._context(place)
        if not effect.within(context, place, shape):
            return 0.0, np.zeros(1)
        x = self._white([effect.columns(context, r, place, shape) for r in context.records])
        if effect.unit_coefficient:
            left = self._left + x[:, 0]
            return self.cost - float(left @ left), np.ones(1)
        scale = np.linalg.norm(x, axis=0)
        if not np.isfinite(scale).all() or np.any(scale < 1e-9):
            return 0.0, np.zeros(x.shape[1])
        x = x / scale
        c = -np.linalg.lstsq(x, self._left, rcond=1e-8)[0]
        if effect.lower and np.any(c / scale < np.array(effect.lower)):
            low = np.array(effect.lower) * scale
            c = lsq_linear(x, -self._left, bounds=(low, np.inf)).x
        left = self._left + x @ c
        return self.cost - float(left @ left), c / scale

    def _best(self, effect: Effect, place: Place) -> Score:
        context = self._context(place)
        found = [(*self._gain(effect, place, s), s) for s in effect.grid(context, place)]
        tried = len(found)
        found.sort(key=lambda f: -f[0])
        if len(found) > 1 and found[0][0] > 4.0:
            for _, _, shape in found[:2]:
                found.append(self._polished(effect, place, shape, sorted({f[2][-1] for f in found})))
        gain, coefficients, shape = max(found, key=lambda f: f[0])
        return Score(Term(effect, place, shape, coefficients), gain, tried)

    def _polished(
        self, effect: Effect, place: Place, shape: Shape, grid: list[float]
    ) -> tuple[float, Float64, Shape]:
        """The best value of the last shape entry between its neighbours on the grid."""
        at = grid.index(shape[-1])
        low = grid[at - 1] if at > 0 else shape[-1] / 3
        high = grid[at + 1] if at + 1 < len(grid) else shape[-1] * 3
        head = shape[:-1]
        if low <= 0:
            return (*self._gain(effect, place, shape), shape)
        search = minimize_scalar(
            lambda u: -self._gain(effect, place, (*head, float(np.exp(u))))[0],
            bounds=(np.log(low), np.log(high)),
            method="bounded",
            options={"maxiter": 12, "xatol": 1e-3},
        )
        best = (*head, float(np.exp(search.x)))
        return (*self._gain(effect, place, best), best)


def _basis_of(state: State, root: Complex128) -> Float64 | None:
    """Orthonormal basis of the whitened boundary terms of a record, or None."""
    if not state.boundary.shape[2]:
        return None
    b = _stack(root @ state.boundary)
    scale = np.linalg.norm(b, axis=0)
    left, size, _ = np.linalg.svd(b[:, scale > 0] / scale[scale > 0], full_matrices=False)
    basis: Float64 = left[:, size > 1e-9 * size[0]]
    return basis
