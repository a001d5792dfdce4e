"""How much a cell varies from run to run: one factor λ on what the fits' covariances say, from its history.

Each run is compared with the mean of the runs before it that agree with it (``baseline.forecast_errors``):
with equal covariances these are independent, each χ² with as many degrees of freedom as parameters, times
λ². So all of the history counts, and a slow drift, which the mean lags behind, counts as bad repeatability.
A change of tool must not: each χ² is cut at the value that one in ten exceeds by chance, and λ² is the
scale at which the cut values have the mean that chance gives them (an M-estimate of scale: 93 % as
efficient as the mean for four parameters). A tool also changes few parameters, bad repeatability all: what
a few of them explain alone is taken out (``baseline.steady``). What is then still far beyond the
calmer half is another robot, not a bad day.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from scipy.special import chdtr

from invid.comparison.baseline import forecast_errors, steady
from invid.comparison.changes import Repeatability
from invid.comparison.joint_test import difference
from invid.model.document import Model
from invid.numerics.distributions import chi2_isf, chi2_sf, f_sf

MINIMUM_RUNS = 2
"""Runs after a first one from which a factor is stated."""
_CUT = 0.1
"""Chance with which a χ² is cut."""
_EFFICIENCY = 0.9
"""Of the degrees of freedom, those that the cut leaves (simulated: 0.93 for 4 parameters, 0.96 for 24)."""
_BELIEVED = 30.0
"""Degrees of freedom from which a factor below 1 is used. From there on Student's t asks for at most a tenth
more than the normal distribution; deciding by the number of runs and not by what comes out keeps the false
alarms what they are stated to be."""
_ANOTHER = 1e-3
"""A step that the calmer ones would exceed with less than this chance is taken for another robot."""
_LEAST_FACTOR = 0.5
"""A guess: fits that claim more than twice the scatter are not believed to be that wrong."""


def repeatability(history: Sequence[Model], *, spanning: tuple[Model, Model] | None = None) -> Repeatability:
    """λ of a history, oldest first; the step between the two models of ``spanning`` may hold the very change
    that is asked for, so no run after it is compared with one before it."""
    found: list[tuple[float, int]] = []
    for piece in _pieces(history, spanning):
        # Agreement with a mean is judged at λ; the steps from run to run give a first one without it.
        steps = [_misfit(a, b) for a, b in pairwise(piece)]
        rough = _scale(_calm([s for s in steps if s is not None]))
        found += forecast_errors(piece, max(1.0, rough))
    found = _calm(found)
    if len(found) < MINIMUM_RUNS:
        return Repeatability(pairs=len(found))
    factor, dof = _scale(found), _EFFICIENCY * sum(count for _, count in found)
    if factor <= 1.0 and dof < _BELIEVED:
        return Repeatability(1.0, len(found))
    return Repeatability(max(factor, _LEAST_FACTOR), len(found), dof)


def _pieces(history: Sequence[Model], spanning: tuple[Model, Model] | None) -> list[Sequence[Model]]:
    """The history cut behind the earlier of the two models, or before the later where it is the only one."""
    if spanning is None:
        return [history]
    at = sorted(k for k, m in enumerate(history) if any(m is s for s in spanning))
    if not at:
        return [history]
    cut = at[0] + 1 if len(at) > 1 or history[at[0]] is spanning[0] else at[0]
    return [history[:cut], history[cut:]]


def _misfit(old: Model, new: Model) -> tuple[float, int] | None:
    """χ² of two models being the same robot but for a few parameters, and its degrees of freedom."""
    white = difference(old, new)
    return None if white is None else steady(white)


def _calm(misfits: Sequence[tuple[float, int]]) -> list[tuple[float, int]]:
    """Without those that the calmer ones rule out: half of them first, then one by one upwards."""
    rising = sorted(misfits, key=lambda m: m[0] / m[1])
    kept = rising[: -(-len(rising) // 2)]
    for chi2, count in rising[len(kept) :]:
        dof = sum(n for _, n in kept)
        mean = sum(x for x, _ in kept) / dof
        if mean > 0 and f_sf(chi2 / count / mean, count, dof) < _ANOTHER:
            break
        kept.append((chi2, count))
    return kept


def _scale(misfits: Sequence[tuple[float, int]]) -> float:
    """λ at which the cut χ²/λ² have the sum that chance gives them; 1 where there are none."""
    cut = [chi2_isf(_CUT, count) for _, count in misfits]
    expected = sum(
        n * float(chdtr(n + 2, c)) + c * chi2_sf(c, n) for c, (_, n) in zip(cut, misfits, strict=True)
    )
    low, high = -12.0, 12.0  # of ln λ²
    if not misfits:
        return 1.0
    for _ in range(60):
        middle = (low + high) / 2
        found = sum(min(x * math.exp(-middle), c) for c, (x, _) in zip(cut, misfits, strict=True))
        low, high = (middle, high) if found > expected else (low, middle)
    return math.exp((low + high) / 4)
