"""Score test of every cause at every place, with linear parameters and chosen causes projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from invid.effects.effect import Effect
from invid.effects.motion import View
from invid.effects.registry import effects
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.parameters import ChainStructure
from invid.model.place import Pattern
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import stack


@dataclass(frozen=True, eq=False)
class Score:
    """Result of the score test of one cause at one place: parameters and χ² it would gain, before any
    refit."""

    term: PlacedEffect
    x: Float64
    gain: float
    shift: Float64 = field(default_factory=lambda: np.zeros(0))
    """(n,) first-order change of all parameters fitted so far; empty where not known."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.term.size


def terms_to_test(
    structure: ChainStructure, *, linear_axes: bool, chosen: Sequence[PlacedEffect] = ()
) -> list[PlacedEffect]:
    """Every cause at every place that the structure allows and that is not ``chosen`` yet."""
    out = []
    for effect in effects():
        if structure.motors < effect.least_axes or (linear_axes and effect.rotary):
            continue
        effect = effect.of_structure(structure)
        for place in effect.places(structure):
            taken = any(t.place == place and not t.effect.stands_beside(effect) for t in chosen)
            most = effect.most_places(structure)
            if most is not None:
                taken |= sum(t.effect.cause == effect.cause for t in chosen) >= most
            if not taken:
                out.append(PlacedEffect(effect, place))
    return out


class Screen:
    """Score tests against one fit: its tangent space is projected out of every cause's columns."""

    def __init__(self, fit: JointFit, apart: slice = slice(0)) -> None:
        """``apart``: parameters of ``fit`` that are left out of the tangent space."""
        self.fit = fit
        evaluation = fit.evaluation
        scale = np.linalg.norm(evaluation.jacobian, axis=0)
        scale[scale == 0] = 1.0
        # A parameter at its bound whose gradient points outwards is not projected out: a hold that is all
        # inside its drive explains no more viscous friction than that, and the rest is to be found.
        free = ~fit.is_stuck
        free[apart] = False
        left, size, right = np.linalg.svd((evaluation.jacobian / scale)[:, free], full_matrices=False)
        seen = size > 1e-10 * size[0]
        self.basis = left[:, seen]
        self._pseudo_inverse = np.zeros((scale.size, int(seen.sum())))
        self._pseudo_inverse[free] = (right[seen].T / size[seen]) / scale[free, None]
        self.residual = evaluation.residual - self.basis @ (self.basis.T @ evaluation.residual)
        self._feedback = [v.feedback for v in evaluation.views]
        self._reconstructed: Pattern | None = None
        self.tail = evaluation.residual.size - sum(
            2 * v.record.omega.size * v.record.torque.shape[1] for v in evaluation.views
        )

    @property
    def views(self) -> tuple[View, ...]:
        """Records of the fit through its linear plant."""
        return self.fit.evaluation.views

    def project(self, columns: Sequence[Complex128]) -> Float64:
        """(rows, L) whitened columns with the tangent space of the fit projected out."""
        parts = []
        evaluation = self.fit.evaluation
        for column, root, basis in zip(columns, evaluation.roots, evaluation.bases, strict=True):
            part = stack(root @ column)
            if basis.size:
                part = part - basis @ (basis.T @ part)
            parts.append(part)
        white = np.concatenate([*parts, np.zeros((self.tail, parts[0].shape[1]))])
        out: Float64 = white - self.basis @ (self.basis.T @ white)
        return out

    def shift(self, term: PlacedEffect, x: Float64) -> Float64:
        """(n,) Gauss–Newton step of the parameters fitted so far with the effect at ``x`` in place."""
        self.reconstruct(term)
        evaluation = self.fit.evaluation
        parts = []
        for view, root, basis in zip(self.views, evaluation.roots, evaluation.bases, strict=True):
            part = stack(root @ term.effect.contribution(view, term.place, x.tolist())[0][..., None])[:, 0]
            parts.append(part - basis @ (basis.T @ part) if basis.size else part)
        white = np.concatenate([*parts, np.zeros(self.tail)]) + evaluation.residual
        out: Float64 = -self._pseudo_inverse @ (self.basis.T @ white)
        return out

    def parameters_taking_up(self, rows: Float64) -> Float64:
        """(n, L) change of the parameters fitted so far that takes up what it can of ``rows`` (rows, L)."""
        out: Float64 = self._pseudo_inverse @ (self.basis.T @ rows)
        return out

    def score_at_shape(self, term: PlacedEffect, shape: Sequence[float]) -> tuple[float, Float64]:
        """Gain of χ² and (k,) parameters of an effect at one shape."""
        effect, place = term.effect, term.place
        if not effect.coefficients:
            columns = self.project(
                [self._nonlinear_contribution(v, term, shape)[..., None] for v in self.views]
            )[:, 0]
            if not np.isfinite(columns).all():
                return -np.inf, np.asarray(shape, dtype=float)
            gain = float(-2.0 * columns @ self.residual - columns @ columns)
            return gain, np.asarray(shape, dtype=float)
        self.reconstruct(term)
        columns = self.project([effect.basis(v, place, shape) for v in self.views])
        gain, coefficients = _regress(effect, columns, self.residual)
        return gain, np.concatenate((coefficients, np.asarray(shape, dtype=float)))

    def reconstruct(self, term: PlacedEffect | None) -> None:
        """Sets the inner motion of every view as if the missing torque came from a force at the term's
        place."""
        is_read = term is not None and term.inner and term.effect.along_pattern
        pattern = term.place.pattern(self.fit.layout.structure) if term is not None and is_read else None
        if pattern == self._reconstructed:
            return
        self._reconstructed = pattern
        for view, feedback, rest in zip(self.views, self._feedback, self.fit.evaluation.missing, strict=True):
            if pattern is None or view.missing is None:
                view.set_inner_motion(feedback)
            else:
                view.set_inner_motion(
                    feedback - view.inner_receptance(pattern) * view.estimated_force(pattern, rest)[:, None]
                )

    def restore_views(self) -> None:
        """Restores the inner motion of the fit in its views."""
        self.reconstruct(None)

    def _nonlinear_contribution(self, view: View, term: PlacedEffect, shape: Sequence[float]) -> Complex128:
        """(F, M) contribution on top of the chosen causes, inner motion iterated with it."""
        self.reconstruct(term)
        if not term.inner or view.missing is not None:
            return term.effect.contribution(view, term.place, shape)[0]
        before = view.feedback
        total: Complex128 = np.zeros_like(view.acting)
        for _ in range(6):
            total, yields = term.effect.contribution(view, term.place, shape)
            if yields is None:
                break
            view.set_inner_motion(before + yields)
        view.set_inner_motion(before)
        return total

    def best(self, term: PlacedEffect, *, polish: bool = False) -> Score:
        """Score at the best shape of the grid; ``polish``: refined between the grid's shapes."""
        self.reconstruct(term)
        grid = term.effect.grid(self.views, term.place)
        if not grid:
            return Score(term, np.zeros(0), -np.inf)
        results = [(*self.score_at_shape(term, shape), shape) for shape in grid]
        gain, x, shape = max(results, key=lambda r: r[0])
        if not polish:
            return Score(term, x, gain)
        if shape:
            gain, x = self._polish(term, gain, x, list(shape), grid)
        return Score(term, x, gain, self.shift(term, x))

    def _polish(
        self, term: PlacedEffect, gain: float, x: Float64, shape: list[float], grid: list[tuple[float, ...]]
    ) -> tuple[float, Float64]:
        """Gain and parameters after bisecting the grid's spacing, one shape after the other."""
        limits = term.effect.limits(self.views, term.place)
        for k in range(len(shape)):
            values = sorted({g[k] for g in grid})
            at = values.index(shape[k])
            around = [values[j] for j in (at - 1, at + 1) if 0 <= j < len(values)]
            width = max((abs(v - shape[k]) for v in around), default=0.7)
            for _ in range(6):
                width *= 0.5
                for sign in (-1.0, 1.0):
                    trial = list(shape)
                    trial[k] = float(np.clip(shape[k] + sign * width, *limits[k]))
                    g, tx = self.score_at_shape(term, trial)
                    if g > gain:
                        gain, x, shape = g, tx, trial
                        break
        return gain, x


def _regress(effect: Effect, columns: Float64, residual: Float64) -> tuple[float, Float64]:
    """Best coefficients within their signs, and the χ² they gain."""
    scale = np.linalg.norm(columns, axis=0)
    good = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    coefficients = np.zeros(columns.shape[1])
    if not good.any() or float(scale.max()) < 1e-9:
        return 0.0, coefficients
    q, r = np.linalg.qr(columns[:, good] / scale[good])
    target = -(q.T @ residual)
    positive = np.array([low == 0.0 for low in effect.lower])[good]
    if target.size == 1:
        found = target / r[0]
        found = np.maximum(found, 0.0) if positive[0] else found
    elif positive.all():
        found, _ = scipy.optimize.nnls(r, target)
    else:
        found = np.linalg.lstsq(r, target, rcond=1e-9)[0]
    coefficients[good] = found / scale[good]
    reached = r @ found
    return float(2.0 * target @ reached - reached @ reached), coefficients
