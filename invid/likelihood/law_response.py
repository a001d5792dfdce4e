"""Derivatives of what effects contribute, inner motion in agreement: all parameters at once.

At the inner motion q that laws f and plant agree on, q = q₀(θ) − Z_ii⁻¹ B f(q, θ), the implicit function
theorem gives dq = (1 + Z_ii⁻¹ B ∂f/∂q Bᵀ)⁻¹ (∂q₀/∂θ − Z_ii⁻¹ B ∂f/∂θ). The laws are looked at once, at the
motion there is; what they do to every parameter is then a product of matrices. How a motor that stands moves
the reversals before and after is left out: it is beyond the band, and the search does not miss it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.motion import View, along
from invid.likelihood.law_slopes import ForceChange, LawSlope
from invid.likelihood.placed_effect import Candidate, PlacedEffect, law_part, law_parts, sum_contributions
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64

PASSES = 12
"""Substitutions at most; with what each has taught the next, two or three are enough for weak effects."""
PLAIN = 4
"""Substitutions before what they taught is put to use: weak effects need no more."""
CLOSE = 1e-3
"""Disagreement over what was asked for, column by column, that a derivative may have: as good as a
difference, and a step of the search needs no more."""
MOST = 1500
"""Real numbers of the laws' forces up to which the equations are solved at once: a third of a second."""


def effect_response(
    view: View, candidate: Candidate, slopes: Sequence[tuple[PlacedEffect, LawSlope]], change: ForceChange
) -> Complex128:
    """(F, M, P) what the effects contribute once inner motion has followed the ``change``."""
    linear = _Linear(view, candidate, slopes)
    solved = linear.solved(change)
    return _substituted(view, linear, change) if solved is None else solved


def _substituted(view: View, linear: _Linear, change: ForceChange) -> Complex128:
    """The same by substitutions.

    The view's secants start the substitutions; each pass teaches the next (Anderson's mixing over all columns
    together, because all have the same matrix).
    """
    columns = change.base.shape[-1]
    active = np.arange(columns)
    state = np.zeros((linear.rows, columns))
    secants, before = view.secants, None
    asked = best = np.full(columns, np.inf)
    total = np.zeros_like(change.total)
    for number in range(PASSES):
        contributed, gap = linear.gap(state, change)
        size = np.linalg.norm(gap, axis=0)
        if number == 0:
            asked, best = size, best.copy()
        better = size < best[active]
        best[active[better]] = size[better]
        total[..., active[better]] = contributed[..., better]
        if before is not None and number >= PLAIN:
            secants = _taught(secants, state - before[0], gap - before[1])
        far = np.isfinite(size) & (best[active] > CLOSE * asked[active])
        if not far.any():
            break
        active, change, state, gap = active[far], change.only(far), state[:, far], gap[:, far]
        before = (state, gap)
        state = state + secants.step(gap)
    return total


def _taught(secants: Secants, moves: Float64, changes: Float64) -> Secants:
    """With the moves of all columns and what they changed."""
    return Secants.of((*secants.moves, *moves.T), (*secants.changes, *changes.T))


class _Linear:
    """The laws and the plant around the motion there is, as a linear map of inner motion and jumps."""

    def __init__(
        self, view: View, candidate: Candidate, slopes: Sequence[tuple[PlacedEffect, LawSlope]]
    ) -> None:
        self._view, self._slopes = view, slopes
        self._lines, self._coordinates = view.base.shape
        patterns = [t.place.pattern(view.structure) for t, _ in slopes]
        self._pushes = np.stack([view.push(p) for p in patterns], axis=-1)
        self._gives = np.stack([view.yields(p) for p in patterns], axis=-1)
        self._unit: Float64 = view.closing.unit if view.closing is not None else np.zeros(0)
        self._patterns = tuple(
            t.place.pattern(view.structure)
            for t in candidate.terms
            if t.place.kind != "axis" and t.effect.along_pattern
        )
        self._gain = view.correction_gain(self._patterns) if slopes and self._patterns else None
        if self._gain is not None:
            self._corrected = np.stack([view.yields(p) for p in self._patterns], axis=-1)
        pairs = zip(candidate.terms, candidate.x, strict=True)
        self._impedances = [
            (t.effect.impedance(view, t.place, x.tolist()), t.place.pattern(view.structure))
            for t, x in pairs
            if isinstance(t.effect, ImpedanceEffect)
        ]
        if self._impedances:
            patterns = [p for _, p in self._impedances]
            self._push = np.stack([view.push(p) for p in patterns], axis=-1)
            self._yields = np.stack([view.yields(p) for p in patterns], axis=-1)
            rows = [z[:, None] * along(p, self._yields) for z, p in self._impedances]
            self._meet = np.linalg.inv(np.eye(len(rows)) + np.stack(rows, axis=1))

    @property
    def rows(self) -> int:
        """Real numbers of inner motion and jumps."""
        count: int = 2 * self._lines * self._coordinates + self._unit.size
        return count

    def gap(self, state: Float64, change: ForceChange) -> tuple[Complex128, Float64]:
        """(F, M, P) contributions at ``state`` (rows, P), and (rows, P) how far it is from what follows."""
        view = self._view
        columns = state.shape[1]
        lines = 2 * self._lines * self._coordinates
        halves = state[:lines].reshape(self._lines, self._coordinates, 2, columns)
        feedback = halves[:, :, 0] + 1j * halves[:, :, 1]
        jumps = state[lines:] / self._unit[:, None]
        inner = change.base + feedback
        forces = np.stack([slope.force(view, change, inner, jumps) for _, slope in self._slopes], axis=1)
        own, back = self._followed(forces, change.missing)
        total, back = own + change.total, back + change.back
        gap = np.empty_like(state)
        disagree = back - feedback
        gap[:lines] = np.stack((disagree.real, disagree.imag), axis=2).reshape(lines, columns)
        if view.closing is not None:
            followed = view.closing.follow(change.missing + total)
            gap[lines:] = (followed - jumps) * self._unit[:, None]
        return total, gap

    def _followed(self, forces: Complex128, missing: Complex128) -> tuple[Complex128, Complex128]:
        """(F, M, P) contributions and (F, ΣN, P) inner motion with ``forces`` (F, laws, P) of the laws, where
        the linear model misses ``missing`` (F, M, P)."""
        view = self._view
        own: Complex128 = self._pushes @ forces
        back: Complex128 = -(self._gives @ forces)
        if self._impedances:
            asked = np.stack([z[:, None] * along(p, back) for z, p in self._impedances], axis=1)
            met = self._meet @ asked
            own += self._push @ met
            back -= self._yields @ met
        if self._gain is not None:
            rest = missing + own
            if view.closing is not None:
                rest = rest + view.closing.torque @ view.closing.follow(rest)
            back -= self._corrected @ (self._gain @ rest)
        return own, back

    def solved(self, change: ForceChange) -> Complex128 | None:
        """(F, M, P) contributions in agreement with inner motion, solved at once; ``None`` where a law is no
        product over time, or the equations are too many."""
        if self._view.closing is not None:
            return None
        parts = [slope.factors(self._view, change) for _, slope in self._slopes]
        taken = [f for f in parts if f is not None]
        ends = np.cumsum([0, *(f.direct.shape[0] for f in taken)])
        if len(taken) < len(parts) or ends[-1] > MOST:
            return None
        laws, lines = len(taken), self._lines
        unit = np.broadcast_to(np.eye(laws, dtype=complex), (lines, laws, laws))
        own, back = self._followed(unit, np.zeros((lines, change.missing.shape[1], laws), dtype=complex))
        nothing = np.zeros((lines, laws, change.base.shape[-1]), dtype=complex)
        _, apart = self._followed(nothing, change.missing)
        moved = change.base + apart + change.back
        matrix, target = np.eye(ends[-1]), np.empty((ends[-1], change.base.shape[-1]))
        for k, (_, slope) in enumerate(self._slopes):
            rows = slice(ends[k], ends[k + 1])
            answer = along(slope.pattern, back)
            target[rows] = (taken[k].read @ along(slope.pattern, moved)).real + taken[k].direct
            for n, other in enumerate(taken):
                matrix[rows, ends[n] : ends[n + 1]] -= (
                    taken[k].read @ (answer[:, n, None] * other.made)
                ).real
        try:
            between = np.linalg.solve(matrix, target)
        except np.linalg.LinAlgError:
            return None
        forces = np.stack([f.made @ between[ends[k] : ends[k + 1]] for k, f in enumerate(taken)], axis=1)
        out: Complex128 = own @ forces + change.total
        return out


def direct_effect_changes(
    view: View, candidate: Candidate, steps: Sequence[tuple[int, int, float]]
) -> tuple[Complex128, Complex128]:
    """(F, M, P) contributions and (F, ΣN, P) inner motion that follow from each parameter of effects at the
    motion there is, by differences; ``steps`` are effect, number of the parameter and difference."""
    view.forget_measured()  # both sides from the same inner motion
    parts = law_parts(view, candidate)
    total, back = sum_contributions(view, candidate, parts)
    totals, backs = [], []
    for number, k, h in steps:
        moved = candidate.x[number].copy()
        moved[k] += h
        x = (*candidate.x[:number], moved, *candidate.x[number + 1 :])
        # The other laws stand where they are: what they contribute is known.
        own = law_part(view, candidate.terms[number], moved)
        changed = (*parts[:number], own, *parts[number + 1 :])
        there = sum_contributions(view, Candidate(candidate.terms, x), changed)
        totals.append((there[0] - total) / h)
        backs.append((there[1] - back) / h)
    return np.stack(totals, axis=-1), np.stack(backs, axis=-1)
