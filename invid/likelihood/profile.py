"""Profile likelihood: intervals of single parameters without a quadratic approximation.

One parameter is held away from its estimate and all others are fitted again; the interval ends where χ² has
risen by χ²/ν, one standard deviation for a parabola. Where the data determine a parameter badly, the interval
is asymmetric or does not end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.covariance import parameter_std
from invid.likelihood.fit import Fit
from invid.likelihood.levenberg_marquardt import gauss_newton
from invid.numerics import budget

MOST_DEVIATIONS = 8.0
"""Standard deviations from which an interval counts as unbounded."""


@dataclass(frozen=True)
class Interval:
    """68 % interval in physical units; ``None`` on a side where it does not end."""

    low: float | None
    high: float | None


def profiles(fit: Fit, names: Sequence[str] | None = None) -> dict[str, Interval]:
    """68 % profile intervals of masses, springs and couplings (or of ``names``) that were free in the fit."""
    structure, solution = fit.problem.structure, fit.solution
    wanted = [
        n
        for n in structure.names
        if any(kind in n for kind in (".mass.", ".spring.", ".coupling", ".ground_spring"))
    ]
    spread = parameter_std(solution)
    place = {n: k for k, n in enumerate(fit.problem.names)}
    out: dict[str, Interval] = {}
    for name in wanted if names is None else names:
        at = place[name]
        if not solution.free[at]:
            continue
        if budget.is_left_out("further profile intervals"):
            break
        ends = [_interval_end(fit, name, at, float(spread[at]), side) for side in (-1.0, 1.0)]
        if structure.logarithmic[at]:
            ends = [None if e is None else float(np.exp(e)) for e in ends]
        out[name] = Interval(ends[0], ends[1])
    return out


def _interval_end(fit: Fit, name: str, at: int, spread: float, side: float) -> float | None:
    """Value at which χ² has risen by χ²/ν on one side (regula falsi on the root of the rise); ``None``
    without end."""
    if not np.isfinite(spread) or spread <= 0:
        return None
    solution = fit.solution
    unit = max(solution.reduced, 1.0)
    held = replace(fit.problem, fixed=(*fit.problem.fixed, name))
    low, low_root, step = 0.0, 0.0, 1.0
    p = solution.p
    for _ in range(8):
        start = p.copy()
        start[at] = solution.p[at] + side * step * spread
        found = gauss_newton(held, start, iterations=25, tolerance=1e-2)
        root = float(np.sqrt(max(found.chi2 - solution.chi2, 0.0) / unit))
        if abs(root - 1.0) < 0.02:
            break
        if root < 1.0:
            low, low_root, p = step, root, found.p
            step = min(step * (1.0 / max(root, 0.25)), 2.0 * step)
            if step > MOST_DEVIATIONS:
                return None
        else:
            step = low + (step - low) * (1.0 - low_root) / (root - low_root)
    return float(solution.p[at] + side * step * spread)
