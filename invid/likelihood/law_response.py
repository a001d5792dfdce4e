"""Derivatives of what effects contribute with the inner motion in agreement, for all parameters at once.

At the inner motion q on which laws f and plant agree, q = q₀(θ) − Z_ii⁻¹ B f(q, θ), the implicit function
theorem gives dq = (1 + Z_ii⁻¹ B ∂f/∂q Bᵀ)⁻¹ (∂q₀/∂θ − Z_ii⁻¹ B ∂f/∂θ). The laws are linearised once, at the
present motion; their response to every parameter is then a product of matrices. The change of a standing
motor's reversals is neglected: it is beyond the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.laws.sign import DryLaw
from invid.effects.motion import View, along
from invid.likelihood.law_slopes import ForceChange, LawSlope
from invid.likelihood.placed_effect import (
    Candidate,
    coupled_impedances,
    force_patterns,
    impedances,
    law_part,
    law_parts,
    laws_beside_dry_friction,
    linear_effects,
    sum_contributions,
)
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64

PASSES = 12
"""Most substitutions; with Anderson mixing two or three are enough for weak effects."""
PLAIN_PASSES = 4
"""Substitutions before the mixing starts; weak effects need no more."""
TOLERANCE = 1e-3
"""Tolerance of a derivative, over its right-hand side, column by column: as good as a finite difference."""
MOST_UNKNOWNS = 1500
"""Most real unknowns of the laws' forces that are solved directly (a third of a second)."""


def effect_response(
    view: View, candidate: Candidate, slopes: Sequence[LawSlope], change: ForceChange
) -> Complex128:
    """(F, M, P) contributions of the effects with the inner motion that follows the ``change``."""
    linear = LinearizedLaws(view, candidate, slopes)
    solved = linear.solve_directly(change)
    return _solve_by_substitution(view, linear, change) if solved is None else solved


def _solve_by_substitution(view: View, linear: LinearizedLaws, change: ForceChange) -> Complex128:
    """(F, M, P) contributions by substitution.

    The view's secants start the iteration; each pass adds to them (Anderson mixing over all columns together,
    because all have the same matrix).
    """
    columns = change.base.shape[-1]
    active = np.arange(columns)
    state = np.zeros((linear.rows, columns))
    secants, before = view.secants, None
    initial = best = np.full(columns, np.inf)
    total = np.zeros_like(change.total)
    for number in range(PASSES):
        contributed, gap = linear.gap(state, change)
        size = np.linalg.norm(gap, axis=0)
        if number == 0:
            initial, best = size, best.copy()
        better = size < best[active]
        best[active[better]] = size[better]
        total[..., active[better]] = contributed[..., better]
        if before is not None and number >= PLAIN_PASSES:
            secants = _add_secants(secants, state - before[0], gap - before[1])
        far = np.isfinite(size) & (best[active] > TOLERANCE * initial[active])
        if not far.any():
            break
        active, change, state, gap = active[far], change.only(far), state[:, far], gap[:, far]
        before = (state, gap)
        state = state + secants.step(gap)
    return total


def _add_secants(secants: Secants, moves: Float64, changes: Float64) -> Secants:
    """The secants with the moves of all columns and their changes added."""
    return Secants.of((*secants.moves.T, *moves.T), (*secants.changes.T, *changes.T))


class LinearAnswer:
    """What effects linear in motion answer to a change of the laws, and the forces that these lack."""

    def __init__(self, view: View, candidate: Candidate) -> None:
        self._view = view
        effects = linear_effects(candidate)
        self._coupled = coupled_impedances(view, effects) if effects else None
        is_inner = any(t.depends_on_inner_motion(view) for t in candidate.terms)
        patterns = force_patterns(view, candidate) if is_inner else ()
        self._gain = view.correction_gain(patterns) if patterns else None
        if self._gain is not None:
            self._corrected = np.stack([view.inner_receptance(p) for p in patterns], axis=-1)

    def of_impedances(self, own: Complex128, back: Complex128) -> tuple[Complex128, Complex128]:
        """(F, M, P) contributions and (F, ΣN, P) inner motion of the laws, with those that effects linear in
        motion add."""
        at = self._coupled
        if at is None:
            return own, back
        alone = np.stack([z[:, None] * along(p, back) for z, p in zip(at.size, at.patterns, strict=True)], 1)
        forces = at.coupling @ alone
        return own + at.condensed_force @ forces, back - at.inner_receptance @ forces

    def of_lacking_forces(self, rest: Complex128) -> Complex128 | float:
        """(F, ΣN, P) inner motion that corrects what ``rest`` (F, M, P) of the missing torque tells."""
        if self._gain is None:
            return 0.0
        closing = self._view.closing
        if closing is not None:
            rest = rest + closing.torque @ closing.jumps_of(rest)
        out: Complex128 = -(self._corrected @ (self._gain @ rest))
        return out


class LinearizedLaws:
    """The laws and the plant linearised at the present motion, as a map of inner motion and jumps."""

    def __init__(self, view: View, candidate: Candidate, slopes: Sequence[LawSlope]) -> None:
        self._view, self._slopes = view, slopes
        self._lines, self._coordinates = view.base.shape
        patterns = [slope.acts_on for slope in slopes]
        self._condensed_forces = np.stack([view.condensed_force(p) for p in patterns], axis=-1)
        self._inner_receptances = np.stack([view.inner_receptance(p) for p in patterns], axis=-1)
        self._unit: Float64 = view.closing.unit if view.closing is not None else np.zeros(0)
        self._answer = LinearAnswer(view, candidate)

    @property
    def rows(self) -> int:
        """Number of real unknowns: inner motion and jumps."""
        count: int = 2 * self._lines * self._coordinates + self._unit.size
        return count

    def gap(self, state: Float64, change: ForceChange) -> tuple[Complex128, Float64]:
        """(F, M, P) contributions at ``state`` (rows, P), and (rows, P) its disagreement."""
        view = self._view
        columns = state.shape[1]
        lines = 2 * self._lines * self._coordinates
        halves = state[:lines].reshape(self._lines, self._coordinates, 2, columns)
        feedback = halves[:, :, 0] + 1j * halves[:, :, 1]
        jumps = state[lines:] / self._unit[:, None]
        inner = change.base + feedback
        forces = np.stack([slope.force(view, change, inner, jumps) for slope in self._slopes], axis=1)
        own, back = self._response_to(forces, change.missing)
        total, back = own + change.total, back + change.back
        gap = np.empty_like(state)
        disagree = view.without_response(back - feedback)
        gap[:lines] = np.stack((disagree.real, disagree.imag), axis=2).reshape(lines, columns)
        if view.closing is not None:
            jumps_after = view.closing.jumps_of(change.missing + total)
            gap[lines:] = (jumps_after - jumps) * self._unit[:, None]
        return total, gap

    def _response_to(self, forces: Complex128, missing: Complex128) -> tuple[Complex128, Complex128]:
        """(F, M, P) contributions and (F, ΣN, P) inner motion under ``forces`` (F, laws, P) of the laws.

        ``missing`` (F, M, P) is the missing torque of the linear model.
        """
        own, back = self._answer.of_impedances(
            self._condensed_forces @ forces, -(self._inner_receptances @ forces)
        )
        return own, back + self._answer.of_lacking_forces(missing + own)

    def solve_directly(self, change: ForceChange) -> Complex128 | None:
        """(F, M, P) contributions solved directly; ``None`` where a law is no product over time or unknowns
        are too many."""
        if self._view.closing is not None:
            return None
        parts = [slope.factors(self._view, change) for slope in self._slopes]
        factors = [f for f in parts if f is not None]
        ends = np.cumsum([0, *(f.direct.shape[0] for f in factors)])
        if len(factors) < len(parts) or ends[-1] > MOST_UNKNOWNS:
            return None
        laws, lines = len(factors), self._lines
        unit = np.broadcast_to(np.eye(laws, dtype=complex), (lines, laws, laws))
        own, back = self._response_to(unit, np.zeros((lines, change.missing.shape[1], laws), dtype=complex))
        no_forces = np.zeros((lines, laws, change.base.shape[-1]), dtype=complex)
        _, by_missing = self._response_to(no_forces, change.missing)
        free_motion = change.base + by_missing + change.back
        matrix, target = np.eye(ends[-1]), np.empty((ends[-1], change.base.shape[-1]))
        for k, own_factors in enumerate(factors):
            rows = slice(ends[k], ends[k + 1])
            target[rows] = own_factors.between(free_motion) + own_factors.direct
            for n, other in enumerate(factors):
                matrix[rows, ends[n] : ends[n + 1]] -= own_factors.between(
                    back[..., n, None] * other.made[:, None]
                )
        try:
            between = np.linalg.solve(matrix, target)
        except np.linalg.LinAlgError:
            return None
        forces = np.stack([f.made @ between[ends[k] : ends[k + 1]] for k, f in enumerate(factors)], axis=1)
        out: Complex128 = own @ forces + change.total
        return out


def direct_effect_changes(
    view: View, candidate: Candidate, steps: Sequence[tuple[int, int, float]]
) -> tuple[Complex128, Complex128]:
    """(F, M, P) derivatives of contributions and (F, ΣN, P) of inner motion by effect parameters, at fixed
    motion.

    ``steps`` are number of the effect, number of the parameter and finite difference.
    """
    view.clear_cache()  # both sides from the same inner motion
    parts = law_parts(view, candidate)
    sum_contributions(view, candidate, parts)  # the view learns from it what corrects inner motion
    yields = sum((p[1] for p in parts if p is not None and p[1] is not None), np.zeros_like(view.base))
    total = np.zeros((*view.acting.shape, len(steps)), dtype=complex)
    back = np.zeros((*view.base.shape, len(steps)), dtype=complex)
    answer = LinearAnswer(view, candidate)
    by_size: list[tuple[int, Complex128, Complex128]] = []
    for at, (number, k, h) in enumerate(steps):
        moved = candidate.x[number].copy()
        moved[k] += h
        there = Candidate(candidate.terms, (*candidate.x[:number], moved, *candidate.x[number + 1 :]))
        # The contributions of the other laws are known: they do not change, but for dry friction beside it.
        changed = {number: law_part(view, candidate.terms[number], moved)}
        known, view.beside = view.beside, laws_beside_dry_friction(there)
        if view.beside != known:
            for n, term in enumerate(candidate.terms):
                if isinstance(term.effect, DryLaw) and term.place.axis == candidate.terms[number].place.axis:
                    changed[n] = law_part(view, term, candidate.x[n])
        view.beside = known
        for n, now in changed.items():
            before = parts[n]
            if now is None or before is None:
                continue
            total[..., at] += (now[0] - before[0]) / h
            for sign, moves in ((1.0, now[1]), (-1.0, before[1])):
                if moves is not None:
                    back[..., at] += (sign / h) * moves
        if changed[number] is None:
            own, own_before = (impedances(view, linear_effects(c), yields) for c in (there, candidate))
            by_size.append((at, (own[0] - own_before[0]) / h, (own[1] - own_before[1]) / h))
    total, back = answer.of_impedances(total, back)
    for at, own_change, moved_by in by_size:
        total[..., at] += own_change
        back[..., at] += moved_by
    return total, back + answer.of_lacking_forces(total)
