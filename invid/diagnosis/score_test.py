"""Score test of every cause at every place, linear parameters and chosen causes projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls

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
    """How much χ² a cause at a place takes away, at its best shape, before anything is refitted."""

    term: PlacedEffect
    x: Float64
    gain: float
    shift: Float64 = field(default_factory=lambda: np.zeros(0))
    """Change of all parameters fitted so far that goes with it, to first order; empty where not known."""

    @property
    def size(self) -> int:
        """Parameters."""
        return self.term.size


def terms_to_test(
    structure: ChainStructure, *, linear_axes: bool, chosen: Sequence[PlacedEffect] = ()
) -> list[PlacedEffect]:
    """Every cause at every place that can be there and is not chosen yet."""
    out = []
    for effect in effects():
        if structure.motors < effect.least_axes or (linear_axes and effect.rotary):
            continue
        for place in effect.places(structure):
            taken = any(t.place == place and not t.effect.stands_beside(effect) for t in chosen)
            most = effect.most_places(structure)
            if most is not None:
                taken |= sum(t.effect.cause == effect.cause for t in chosen) >= most
            if not taken:
                out.append(PlacedEffect(effect, place))
    return out


class Screen:
    """The projection of one fit, and scores against it."""

    def __init__(self, fit: JointFit) -> None:
        self.fit = fit
        evaluation = fit.evaluation
        scale = np.linalg.norm(evaluation.jacobian, axis=0)
        scale[scale == 0] = 1.0
        # A parameter that stands at its bound and would go on takes nothing away: a hold that is all inside
        # its drive is no more viscous friction than that, and the rest of it is there to be found.
        free = ~fit.stuck
        left, size, right = np.linalg.svd((evaluation.jacobian / scale)[:, free], full_matrices=False)
        seen = size > 1e-10 * size[0]
        self.basis = left[:, seen]
        self._back = np.zeros((scale.size, int(seen.sum())))
        self._back[free] = (right[seen].T / size[seen]) / scale[free, None]
        self.residual = evaluation.residual - self.basis @ (self.basis.T @ evaluation.residual)
        self._feedback = [v.feedback for v in evaluation.views]
        self._at: Pattern | None = None
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
            part = stack(root @ column)
            if basis.size:
                part = part - basis @ (basis.T @ part)
            parts.append(part)
        white = np.concatenate([*parts, np.zeros((self.tail, parts[0].shape[1]))])
        out: Float64 = white - self.basis @ (self.basis.T @ white)
        return out

    def shift(self, term: PlacedEffect, x: Float64) -> Float64:
        """(n,) Gauss–Newton step of the parameters fitted so far with the effect at ``x`` in place."""
        self._reconstruct(term)
        evaluation = self.fit.evaluation
        parts = []
        for view, root, basis in zip(self.views, evaluation.roots, evaluation.bases, strict=True):
            part = stack(root @ term.effect.contribution(view, term.place, x.tolist())[0][..., None])[:, 0]
            parts.append(part - basis @ (basis.T @ part) if basis.size else part)
        white = np.concatenate([*parts, np.zeros(self.tail)]) + evaluation.residual
        out: Float64 = -self._back @ (self.basis.T @ white)
        return out

    def at(self, term: PlacedEffect, shape: Sequence[float]) -> tuple[float, Float64]:
        """Gain and parameter vector at one shape."""
        effect, place = term.effect, term.place
        if not effect.coefficients:
            columns = self.project([self._nonlinear(v, term, shape)[..., None] for v in self.views])[:, 0]
            if not np.isfinite(columns).all():
                return -np.inf, np.asarray(shape, dtype=float)
            gain = float(-2.0 * columns @ self.residual - columns @ columns)
            return gain, np.asarray(shape, dtype=float)
        self._reconstruct(term)
        columns = self.project([effect.basis(v, place, shape) for v in self.views])
        gain, coefficients = _regress(effect, columns, self.residual)
        return gain, np.concatenate((coefficients, np.asarray(shape, dtype=float)))

    def _reconstruct(self, term: PlacedEffect | None) -> None:
        """Inner motion of every view, had the missing torque come from a force at the term's place."""
        read = term is not None and term.inner and term.effect.along_pattern
        pattern = term.place.pattern(self.fit.layout.structure) if term is not None and read else None
        if pattern == self._at:
            return
        self._at = pattern
        for view, own, rest in zip(self.views, self._feedback, self.fit.evaluation.missing, strict=True):
            if pattern is None or view.missing is None:
                view.respond(own)
            else:
                view.respond(own - view.yields(pattern) * view.inferred(pattern, rest)[:, None])

    def release(self) -> None:
        """Gives the views of the fit their own inner motion back."""
        self._reconstruct(None)

    def _nonlinear(self, view: View, term: PlacedEffect, shape: Sequence[float]) -> Complex128:
        """Contribution on top of the causes chosen, inner motion in agreement with it."""
        self._reconstruct(term)
        if not term.inner or view.missing is not None:
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

    def best(self, term: PlacedEffect, *, polish: bool = False) -> Score:
        """The best shape of the grid, polished between its neighbours where asked."""
        self._reconstruct(term)
        grid = term.effect.grid(self.views, term.place)
        if not grid:
            return Score(term, np.zeros(0), -np.inf)
        results = [(*self.at(term, shape), shape) for shape in grid]
        gain, x, shape = max(results, key=lambda r: r[0])
        if not polish:
            return Score(term, x, gain)
        if shape:
            gain, x = self._polish(term, gain, x, list(shape), grid)
        return Score(term, x, gain, self.shift(term, x))

    def _polish(
        self, term: PlacedEffect, gain: float, x: Float64, shape: list[float], grid: list[tuple[float, ...]]
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
    if target.size == 1:
        found = target / r[0]
        found = np.maximum(found, 0.0) if positive[0] else found
    elif positive.all():
        found, _ = nnls(r, target)
    else:
        found = np.linalg.lstsq(r, target, rcond=1e-9)[0]
    coefficients[good] = found / scale[good]
    reached = r @ found
    return float(2.0 * target @ reached - reached @ reached), coefficients
