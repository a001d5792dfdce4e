"""Score test of every cause at every place, linear parameters and chosen causes projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from invid.arrays import Complex128, Float64
from invid.discrepancy.joint import JointFit
from invid.discrepancy.plant import Term, _stack
from invid.effects import CATALOGUE
from invid.effects.base import Effect, View
from invid.refine.structure import ChainStructure


@dataclass(frozen=True, eq=False)
class Score:
    """How much χ² a cause at a place takes away, at its best shape, before anything is refitted."""

    term: Term
    x: Float64
    gain: float

    @property
    def size(self) -> int:
        """Parameters."""
        return self.term.size


def terms_for(structure: ChainStructure, *, linear_axes: bool, chosen: Sequence[Term] = ()) -> list[Term]:
    """Every cause at every place that can be there and is not chosen yet."""
    out = []
    for effect in CATALOGUE:
        if structure.motors < effect.least_axes or (linear_axes and effect.rotary):
            continue
        for place in effect.places(structure):
            taken = any(
                t.place == place
                and (
                    t.effect.cause == effect.cause
                    or (effect.family and t.effect.family == effect.family == "friction")
                )
                for t in chosen
            )
            # A scale common to all axes cannot be seen: only motors − 1 gains are there to be found.
            if effect.cause == "torque_gain":
                taken |= sum(t.effect.cause == effect.cause for t in chosen) >= structure.motors - 1
            if not taken:
                out.append(Term(effect, place))
    return out


class Screen:
    """The projection of one fit, and scores against it."""

    def __init__(self, fit: JointFit) -> None:
        self.fit = fit
        evaluation = fit.evaluation
        scale = np.linalg.norm(evaluation.jacobian, axis=0)
        scale[scale == 0] = 1.0
        left, size, _ = np.linalg.svd(evaluation.jacobian / scale, full_matrices=False)
        self.basis = left[:, size > 1e-10 * size[0]]
        self.residual = evaluation.residual - self.basis @ (self.basis.T @ evaluation.residual)
        self.tail = evaluation.residual.size - sum(
            2 * v.record.omega.size * v.record.torque.shape[1] for v in evaluation.views
        )

    @property
    def views(self) -> tuple[View, ...]:
        """The records."""
        return self.fit.evaluation.views

    def project(self, columns: Sequence[Complex128]) -> Float64:
        """(rows, L) whitened columns without what the fit already explains."""
        parts = []
        evaluation = self.fit.evaluation
        for column, root, basis in zip(columns, evaluation.roots, evaluation.bases, strict=True):
            part = _stack(root @ column)
            if basis.size:
                part = part - basis @ (basis.T @ part)
            parts.append(part)
        white = np.concatenate([*parts, np.zeros((self.tail, parts[0].shape[1]))])
        out: Float64 = white - self.basis @ (self.basis.T @ white)
        return out

    def at(self, term: Term, shape: Sequence[float]) -> tuple[float, Float64]:
        """Gain and parameter vector at one shape."""
        effect, place = term.effect, term.place
        if not effect.coefficients:
            columns = self.project([self._nonlinear(v, term, shape)[..., None] for v in self.views])[:, 0]
            if not np.isfinite(columns).all():
                return -np.inf, np.asarray(shape, dtype=float)
            gain = float(-2.0 * columns @ self.residual - columns @ columns)
            return gain, np.asarray(shape, dtype=float)
        columns = self.project([effect.basis(v, place, shape) for v in self.views])
        gain, coefficients = _regress(effect, columns, self.residual)
        return gain, np.concatenate((coefficients, np.asarray(shape, dtype=float)))

    def _nonlinear(self, view: View, term: Term, shape: Sequence[float]) -> Complex128:
        """Contribution on top of the causes chosen, inner motion in agreement with it."""
        if not term.inner:
            return term.effect.contribution(view, term.place, shape)[0]
        before = view.feedback
        total: Complex128 = np.zeros_like(view.acting)
        for _ in range(6):
            total, yields = term.effect.contribution(view, term.place, shape)
            if yields is None:
                break
            view.respond(before + yields)
        view.respond(before)
        return total

    def best(self, term: Term, *, polish: bool = False) -> Score:
        """The best shape of the grid, polished between its neighbours where asked."""
        grid = term.effect.grid(self.views, term.place)
        if not grid:
            return Score(term, np.zeros(0), -np.inf)
        results = [(*self.at(term, shape), shape) for shape in grid]
        gain, x, shape = max(results, key=lambda r: r[0])
        if polish and shape:
            gain, x = self._polish(term, gain, x, list(shape), grid)
        return Score(term, x, gain)

    def _polish(
        self, term: Term, gain: float, x: Float64, shape: list[float], grid: list[tuple[float, ...]]
    ) -> tuple[float, Float64]:
        """Bisection of the grid's spacing, one shape after the other."""
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
                    g, tx = self.at(term, trial)
                    if g > gain:
                        gain, x, shape = g, tx, trial
                        break
        return gain, x


def _regress(effect: Effect, columns: Float64, residual: Float64) -> tuple[float, Float64]:
    """Best coefficients within their signs, and the χ² they take away."""
    scale = np.linalg.norm(columns, axis=0)
    good = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    coefficients = np.zeros(columns.shape[1])
    if not good.any() or float(scale.max()) < 1e-9:
        return 0.0, coefficients
    q, r = np.linalg.qr(columns[:, good] / scale[good])
    target = -(q.T @ residual)
    positive = np.array([low == 0.0 for low in effect.lower])[good]
    if positive.all():
        found, _ = nnls(r, target)
    else:
        found = np.linalg.lstsq(r, target, rcond=1e-9)[0]
    coefficients[good] = found / scale[good]
    reached = r @ found
    return float(2.0 * target @ reached - reached @ reached), coefficients
