"""Derivatives of what effects contribute with the inner motion in agreement, for all parameters at once.

At the inner motion q on which laws f and plant agree, q = q₀(θ) − Z_ii⁻¹ B f(q, θ), the implicit function
theorem gives dq = (1 + Z_ii⁻¹ B ∂f/∂q Bᵀ)⁻¹ (∂q₀/∂θ − Z_ii⁻¹ B ∂f/∂θ). The laws are linearised once, at the
present motion; their response to every parameter is then a product of matrices. The change of a standing
motor's reversals is neglected: it is beyond the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import ImpedanceEffect
from invid.effects.laws.sign import DryLaw
from invid.effects.motion import View, along
from invid.likelihood.law_slopes import ForceChange, LawSlope
from invid.likelihood.placed_effect import (
    Candidate,
    PlacedEffect,
    law_part,
    law_parts,
    laws_beside_dry_friction,
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
    view: View, candidate: Candidate, slopes: Sequence[tuple[PlacedEffect, LawSlope]], change: ForceChange
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
    return Secants.of((*secants.moves, *moves.T), (*secants.changes, *changes.T))


class LinearizedLaws:
    """The laws and the plant linearised at the present motion, as a map of inner motion and jumps."""

    def __init__(
        self, view: View, candidate: Candidate, slopes: Sequence[tuple[PlacedEffect, LawSlope]]
    ) -> None:
        self._view, self._slopes = view, slopes
        self._lines, self._coordinates = view.base.shape
        patterns = [t.place.pattern(view.structure) for t, _ in slopes]
        self._condensed_forces = np.stack([view.condensed_force(p) for p in patterns], axis=-1)
        self._inner_receptances = np.stack([view.inner_receptance(p) for p in patterns], axis=-1)
        self._unit: Float64 = view.closing.unit if view.closing is not None else np.zeros(0)
        self._patterns = tuple(
            t.place.pattern(view.structure)
            for t in candidate.terms
            if t.place.kind != "axis" and t.effect.along_pattern
        )
        self._gain = view.correction_gain(self._patterns) if slopes and self._patterns else None
        if self._gain is not None:
            self._corrected = np.stack([view.inner_receptance(p) for p in self._patterns], axis=-1)
        pairs = zip(candidate.terms, candidate.x, strict=True)
        self._impedances = [
            (
                t.effect.impedance(view, t.place, x.tolist()),
                t.effect.pattern(view.structure, t.place, x.tolist()),
            )
            for t, x in pairs
            if isinstance(t.effect, ImpedanceEffect)
        ]
        if self._impedances:
            patterns = [p for _, p in self._impedances]
            self._impedance_forces = np.stack([view.condensed_force(p) for p in patterns], axis=-1)
            self._impedance_receptances = np.stack([view.inner_receptance(p) for p in patterns], axis=-1)
            rows = [z[:, None] * along(p, self._impedance_receptances) for z, p in self._impedances]
            self._coupling = np.linalg.inv(np.eye(len(rows)) + np.stack(rows, axis=1))

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
        forces = np.stack([slope.force(view, change, inner, jumps) for _, slope in self._slopes], axis=1)
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
        view = self._view
        own: Complex128 = self._condensed_forces @ forces
        back: Complex128 = -(self._inner_receptances @ forces)
        if self._impedances:
            alone = np.stack([z[:, None] * along(p, back) for z, p in self._impedances], axis=1)
            coupled = self._coupling @ alone
            own += self._impedance_forces @ coupled
            back -= self._impedance_receptances @ coupled
        if self._gain is not None:
            rest = missing + own
            if view.closing is not None:
                rest = rest + view.closing.torque @ view.closing.jumps_of(rest)
            back -= self._corrected @ (self._gain @ rest)
        return own, back

    def solve_directly(self, change: ForceChange) -> Complex128 | None:
        """(F, M, P) contributions solved directly; ``None`` where a law is no product over time or unknowns
        are too many."""
        if self._view.closing is not None:
            return None
        parts = [slope.factors(self._view, change) for _, slope in self._slopes]
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
        for k, (_, slope) in enumerate(self._slopes):
            rows = slice(ends[k], ends[k + 1])
            answer = along(slope.pattern, back)
            target[rows] = (factors[k].read @ along(slope.pattern, free_motion)).real + factors[k].direct
            for n, other in enumerate(factors):
                matrix[rows, ends[n] : ends[n + 1]] -= (
                    factors[k].read @ (answer[:, n, None] * other.made)
                ).real
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
    total, back = sum_contributions(view, candidate, parts)
    is_sum = not any(
        isinstance(t.effect, ImpedanceEffect) or t.depends_on_inner_motion(view) for t in candidate.terms
    )
    totals, backs = [], []
    for number, k, h in steps:
        moved = candidate.x[number].copy()
        moved[k] += h
        x = (*candidate.x[:number], moved, *candidate.x[number + 1 :])
        there_candidate = Candidate(candidate.terms, x)
        # The contributions of the other laws are known: they do not change, but for dry friction beside it.
        changed = list(parts)
        changed[number] = law_part(view, candidate.terms[number], moved)
        known, view.beside = view.beside, laws_beside_dry_friction(there_candidate)
        is_felt_beside = view.beside != known
        if is_felt_beside:
            for n, term in enumerate(candidate.terms):
                if isinstance(term.effect, DryLaw) and term.place.axis == candidate.terms[number].place.axis:
                    changed[n] = law_part(view, term, x[n])
        view.beside = known
        own, own_before = changed[number], parts[number]
        if is_sum and not is_felt_beside and own is not None and own_before is not None:
            totals.append((own[0] - own_before[0]) / h)  # the other laws feel nothing of it
            moved_by = [np.zeros_like(back) if p[1] is None else p[1] for p in (own, own_before)]
            backs.append((moved_by[0] - moved_by[1]) / h)
            continue
        there = sum_contributions(view, there_candidate, changed)
        totals.append((there[0] - total) / h)
        backs.append((there[1] - back) / h)
    return np.stack(totals, axis=-1), np.stack(backs, axis=-1)
