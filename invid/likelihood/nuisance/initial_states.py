"""What a contact remembers from before a record: unknown, and found with the rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar

from invid.effects.motion import View
from invid.likelihood.placed_effect import Candidate, contributions
from invid.model.place import Pattern
from invid.numerics.arrays import Complex128

LOOKED = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Where a slider may start, over what it gives way at."""
WITHIN, TRIES = 0.5, 14
"""How far around the best of them is searched, and with how many looks."""
LITTLE = 0.02
"""Step of the differences by which a start that is known nearly is improved."""

Cost = Callable[[Complex128], float]
"""χ² of a record with contributions (F, M)."""


def solve_initial_states(
    view: View, candidate: Candidate, extra: Complex128, cost: Cost
) -> tuple[Complex128, Complex128]:
    """(F, M) contributions from the starts that leave least, and (F, M, k) what they change by with each.

    A slider in a weak motion may never give way in both directions: then all of a record feels where it
    stood before, be it as a constant torque. At half the amplitude presliding friction of 37 dB left 480
    times the noise from rest, and none from where it had stood. ``view.starts`` keeps the answer.
    """
    columns = []
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        if term.effect.remembers(view, term.place, x.tolist()):
            extra, column = _best(view, candidate, term.place.pattern(view.structure), cost)
            columns.append(column)
        elif view.starts:
            view.starts.pop(term.place.pattern(view.structure), None)
    return extra, np.stack(columns, axis=-1) if columns else np.zeros((*extra.shape, 0), dtype=complex)


def _best(view: View, candidate: Candidate, pattern: Pattern, cost: Cost) -> tuple[Complex128, Complex128]:
    """Contributions at the best start of one slider, and their derivative by it."""

    def at(start: float) -> Complex128:
        view.starts[pattern] = start
        return contributions(view, candidate)

    known = view.starts.get(pattern)
    if known is None:
        known = min(LOOKED, key=lambda s: cost(at(s)))
        around = max(known - WITHIN, -1.0), min(known + WITHIN, 1.0)
        options = {"maxiter": TRIES, "xatol": 0.1 * LITTLE}
        found = minimize_scalar(lambda s: cost(at(s)), bounds=around, method="bounded", options=options)
        known = float(found.x)
    middle = float(np.clip(known, LITTLE - 1.0, 1.0 - LITTLE))
    low, here, high = (at(s) for s in (middle - LITTLE, middle, middle + LITTLE))
    column: Complex128 = (high - low) / (2.0 * LITTLE)
    costs = cost(low), cost(here), cost(high)
    slope, bend = 0.5 * (costs[2] - costs[0]) / LITTLE, (costs[0] - 2.0 * costs[1] + costs[2]) / LITTLE**2
    step = -slope / bend if bend > 0.0 else -np.copysign(WITHIN, slope)
    there = float(np.clip(middle + np.clip(step, -WITHIN, WITHIN), -1.0, 1.0))
    moved = at(there)
    if cost(moved) < costs[1]:
        return moved, column
    return at(middle), column


__all__ = ["solve_initial_states"]
