"""Initial states of contacts with memory, fitted with the rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from invid.effects.motion import View
from invid.likelihood.placed_effect import Candidate, contributions
from invid.model.place import Pattern
from invid.numerics.arrays import Complex128

START_GRID = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Initial displacements of a slider that are tried, over the displacement at which it slides."""
SEARCH_RADIUS, MOST_TRIALS = 0.5, 14
"""Half-width of the search around the best of them, and most evaluations."""
DIFFERENCE = 0.02
"""Step of the finite differences by which a known start is improved."""

Cost = Callable[[Complex128], float]
"""Function that returns χ² of a record with contributions (F, M)."""


def solve_initial_states(
    view: View, candidate: Candidate, extra: Complex128, cost: Cost
) -> tuple[Complex128, Complex128]:
    """(F, M) contributions at the best initial states, and (F, M, k) their derivatives by each.

    A slider in a weak motion may never slide in both directions: then all of a record depends on its initial
    state, if only as a constant torque. At half the amplitude presliding friction of 37 dB left 480 times the
    noise from rest, and none from its true state. ``view.starts`` keeps the states.
    """
    columns = []
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.effect.remembers(view, term.place, x.tolist()):
            extra, column = _best_start(view, candidate, term.place.pattern(view.structure), cost)
            columns.append(column)
        elif view.starts:
            view.starts.pop(term.place.pattern(view.structure), None)
    return extra, np.stack(columns, axis=-1) if columns else np.zeros((*extra.shape, 0), dtype=complex)


def _best_start(
    view: View, candidate: Candidate, pattern: Pattern, cost: Cost
) -> tuple[Complex128, Complex128]:
    """Contributions at the best initial state of one slider, and their derivative by it."""

    def contributions_at(start: float) -> Complex128:
        view.starts[pattern] = start
        return contributions(view, candidate)

    known = view.starts.get(pattern)
    if known is None:
        known = min(START_GRID, key=lambda s: cost(contributions_at(s)))
        around = max(known - SEARCH_RADIUS, -1.0), min(known + SEARCH_RADIUS, 1.0)
        options = {"maxiter": MOST_TRIALS, "xatol": 0.1 * DIFFERENCE}
        found = scipy.optimize.minimize_scalar(
            lambda s: cost(contributions_at(s)), bounds=around, method="bounded", options=options
        )
        known = float(found.x)
    middle = float(np.clip(known, DIFFERENCE - 1.0, 1.0 - DIFFERENCE))
    low, here, high = (contributions_at(s) for s in (middle - DIFFERENCE, middle, middle + DIFFERENCE))
    column: Complex128 = (high - low) / (2.0 * DIFFERENCE)
    costs = cost(low), cost(here), cost(high)
    slope, bend = (
        0.5 * (costs[2] - costs[0]) / DIFFERENCE,
        (costs[0] - 2.0 * costs[1] + costs[2]) / DIFFERENCE**2,
    )
    step = -slope / bend if bend > 0.0 else -np.copysign(SEARCH_RADIUS, slope)
    candidate_start = float(np.clip(middle + np.clip(step, -SEARCH_RADIUS, SEARCH_RADIUS), -1.0, 1.0))
    improved = contributions_at(candidate_start)
    if cost(improved) < costs[1]:
        return improved, column
    return contributions_at(middle), column


__all__ = ["solve_initial_states"]
