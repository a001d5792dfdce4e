"""Measurements of one unchanged robot: their mean, and λ, by how much they scatter beyond their fits.

The difference of two single runs has √2 times the deviation of one; against the mean of K runs it has √(1 +
1/K). Only runs that agree with each other are averaged, newest first, up to the first that does not: behind
it lies another state of the robot.

λ: each run is compared with the mean of the runs before it that agree with it (``forecast_errors``): with
equal covariances these are independent, each χ² with as many degrees of freedom as parameters, times λ². So
all of the history counts, and a slow drift, which the mean lags behind, counts as bad repeatability. A
change of tool must not: each χ² is cut at the value that one in ten exceeds by chance, and λ² is the scale
at which the cut values have the mean that chance gives them (an M-estimate of scale: 93 % as efficient as
the mean for four parameters). A tool also changes few parameters, bad repeatability all: what a few of them
explain alone is taken out (``steady``). What is then still far beyond the calmer half is another robot, not
a bad day.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtr

from invid.comparison.changes import Repeatability
from invid.comparison.joint_test import Whitened, joint_p, select, two_sided
from invid.comparison.numbers import covariance_of_differences, has_same_shape, mean_model, paired_numbers
from invid.model.document import Model
from invid.numerics.distributions import chi2_isf, chi2_sf, f_sf

MOST = 8
"""Runs averaged at most: with eight the deviation of a difference is within 6 % of what any number could
give, and a slow drift of the cell has less time to come in."""
AGREE = 0.01
"""A run that agrees with the mean worse than this (p) is not averaged: what the comparison itself would call
changed at its default level is no repetition. Stricter (0.05), it left a run that is off by chance standing
alone as a baseline one time in twenty, which raises more alarms than it prevents (simulated)."""
SPARSE = 1e-3
"""Chance with which a few parameters explain so much of a difference that has nothing to do with them."""
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


def _difference(old: Model, new: Model, factor: float = 1.0) -> tuple[Whitened | None, list[float]]:
    """new − old of the linear parameters in white coordinates, ``None`` where nothing can be judged, and the
    z of what effects have; deviations are ``factor`` times what the fits say."""
    is_same = old.linear == new.linear and old.chains.masses_per_branch == new.chains.masses_per_branch
    rows = paired_numbers(old, new, old.axes) if is_same and old.axes == new.axes else []
    known = [c for c in rows if c.std and c.cause is None]
    scores = [(c.difference or 0.0) / (factor * c.std) for c in rows if c.std and c.cause is not None]
    if not known:
        return None, scores
    covariance = factor**2 * covariance_of_differences(known, (old, new))
    white, is_sound = Whitened.of(np.array([c.difference for c in known], dtype=float), covariance)
    return white if is_sound else None, scores


def agrees_with(mean: Model, other: Model, factor: float) -> bool:
    """True where ``other`` may be one more measurement of what ``mean`` is the mean of."""
    if not has_same_shape(mean, other):
        return False
    white, scores = _difference(mean, other, factor)
    # A third each: a difference spread over many parameters, one in a single one, one in an effect.
    share = AGREE / 3
    if white is None or joint_p(white, math.inf) < share or select(white, share, math.inf).chosen:
        return False
    return all(len(scores) * two_sided(z, math.inf) >= share for z in scores)


def pool_agreeing(model: Model, earlier: Sequence[Model], factor: float) -> list[Model]:
    """Return ``model`` and the models before it that agree with it, oldest first; ``earlier`` is oldest
    first.
    """
    group = [model]
    for other in reversed(earlier):
        if len(group) == MOST or not agrees_with(mean_model(group), other, factor):
            break
        group.insert(0, other)
    return group


def steady(white: Whitened) -> tuple[float, int]:
    """χ² and degrees of freedom of a difference without the few parameters, at most a third of all, that
    stand out of it by far: those of a tool that was changed."""
    total, count = white.chi2, white.data.size
    chosen: list[int] = []
    rest, best, least = total, (total, count), SPARSE
    for k in range(1, count // 3 + 1 if total > 0 else 1):
        z = white.scores(chosen)
        chosen.append(int(np.argmax(np.abs(z))))
        rest = max(rest - float(z[chosen[-1]]) ** 2, 1e-12 * total)
        gained = (total - rest) / k / (rest / (count - k))
        chance = math.comb(count, k) * f_sf(gained, k, count - k)
        if chance < least:
            best, least = (rest, count - k), chance
    return best


def forecast_errors(history: Sequence[Model], factor: float) -> list[tuple[float, int]]:
    """``steady`` of each run against the mean of the runs before it that agree with it, oldest first."""
    found: list[tuple[float, int]] = []
    group = list(history[:1])
    for model in history[1:]:
        mean = mean_model(group)
        white, _ = _difference(mean, model)
        if white is not None:
            found.append(steady(white))
        group = [*group, model][-MOST:] if agrees_with(mean, model, factor) else [model]
    return found


def repeatability(history: Sequence[Model], *, spanning: tuple[Model, Model]) -> Repeatability:
    """λ of a history, oldest first; the step between the two models of ``spanning`` may hold the very change
    that is asked for, so no run after it is compared with one before it."""
    at = [k for k, m in enumerate(history) if any(m is s for s in spanning)]
    cut = 0
    if at:
        cut = at[0] + (len(at) > 1 or history[at[0]] is spanning[0])
    found: list[tuple[float, int]] = []
    for piece in (history[:cut], history[cut:]):
        # Agreement with a mean is judged at λ; a first pass, in which few agree, gives that.
        rough = _scale(_calm(forecast_errors(piece, 1.0)))
        found += forecast_errors(piece, max(1.0, rough))
    found = _calm(found)
    if len(found) < MINIMUM_RUNS:
        return Repeatability(pairs=len(found))
    factor, dof = _scale(found), _EFFICIENCY * sum(count for _, count in found)
    if factor <= 1.0 and dof < _BELIEVED:
        return Repeatability(1.0, len(found))
    return Repeatability(max(factor, _LEAST_FACTOR), len(found), dof)


def _calm(misfits: Sequence[tuple[float, int]]) -> list[tuple[float, int]]:
    """Return the misfits without those that the calmer ones rule out: half of them first, then one by
    one upwards.
    """
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
    if not misfits:
        return 1.0
    chi2, count = np.array(misfits).T
    cut = np.array([chi2_isf(_CUT, n) for n in count])
    expected = sum(n * chdtr(n + 2, c) + c * chi2_sf(c, n) for c, n in zip(cut, count, strict=True))

    def missing(log_square: float) -> float:
        return float(np.minimum(chi2 * math.exp(-log_square), cut).sum() - expected)

    low = -12.0  # of ln λ²
    return math.exp(low / 2 if missing(low) < 0 else float(brentq(missing, low, 60.0)) / 2)
