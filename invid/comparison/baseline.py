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
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtr

from invid.comparison.changes import Repeatability
from invid.comparison.joint_test import Whitened, difference, joint_p, select, two_sided
from invid.model.document import (
    EffectTerm,
    Estimate,
    Model,
    chains_by_name,
    parameter_vector,
    std_by_name,
    stds_by_name,
)
from invid.numerics.arrays import Float64, frozen_float
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


def has_same_shape(one: Model, other: Model) -> bool:
    """True where both have the same parameters, effects included, so that a mean has a meaning."""
    return (
        one.linear == other.linear
        and parameter_vector(one.chains)[0] == parameter_vector(other.chains)[0]
        and [_key(t) for t in _sorted(one)] == [_key(t) for t in _sorted(other)]
    )


def _key(term: EffectTerm) -> tuple[str, ...]:
    return (term.axis, term.cause, term.element or "", term.other_axis or "", *term.parameters)


def _sorted(model: Model) -> list[EffectTerm]:
    return sorted(model.effects, key=_key)


def pool_models(models: Sequence[Model]) -> Model:
    """Mean of models of the same shape (the last gives names and facts), with the covariance of that mean.

    One weight a model, by the size of its variances: the mean of each parameter then lies between its values,
    which inverse covariance matrices do not promise where correlations are strong and themselves estimates.
    """
    last = models[-1]
    if len(models) == 1:
        return last
    weights = _weights(models)

    names, _ = parameter_vector(last.chains)
    values = [parameter_vector(m.chains)[1] for m in models]
    stds = [[stds_by_name(m)[n] for n in names] for m in models]
    mean: Float64 = np.asarray(sum(w * v for w, v in zip(weights, values, strict=True)))
    spread = np.sqrt(sum((w * np.array(s)) ** 2 for w, s in zip(weights, stds, strict=True)))
    ground = sum(w * m.chains.ground_dampers for w, m in zip(weights, models, strict=True))
    last_chains = replace(last.chains, ground_dampers=frozen_float(ground))
    chains = chains_by_name(last_chains, dict(zip(names, mean, strict=True)))
    std = std_by_name(chains, dict(zip(names, spread, strict=True)))
    joint: Float64 | None = None
    matrices = [m.covariance for m in models if m.parameter_names == last.parameter_names]
    known = [c for c in matrices if c is not None]
    if len(known) == len(models):
        joint = frozen_float(sum(w**2 * c for w, c in zip(weights, known, strict=True)))
    terms = zip(*(_sorted(m) for m in models), strict=True)
    return replace(
        last,
        chains=chains,
        std=std,
        covariance=joint,
        effects=tuple(_mean_effect(same, weights) for same in terms),
    )


def _weights(models: Sequence[Model]) -> list[float]:
    stds = np.array([np.concatenate([*m.std.masses, *m.std.springs, *m.std.dampers]) for m in models])
    good = np.all(np.isfinite(stds) & (stds > 0), axis=0)
    if not good.any():
        return [1.0 / len(models)] * len(models)
    size = -2.0 * np.log(stds[:, good]).mean(axis=1)
    weight = np.exp(size - size.max())
    return [float(w) for w in weight / weight.sum()]


def _mean_effect(terms: Sequence[EffectTerm], weights: Sequence[float]) -> EffectTerm:
    last = terms[-1]
    parameters: dict[str, Estimate] = {}
    for name, own in last.parameters.items():
        each = [t.parameters[name] for t in terms]
        offset = sum(w * _apart(name, own.value, e.value) for w, e in zip(weights, each, strict=True))
        stds = [e.std for e in each if e.std is not None]
        std = (
            math.hypot(*(w * s for w, s in zip(weights, stds, strict=True)))
            if len(stds) == len(each)
            else None
        )
        parameters[name] = replace(own, value=own.value + offset, std=std)
    return replace(last, parameters=parameters)


def agrees_with(mean: Model, other: Model, factor: float) -> bool:
    """True where ``other`` may be one more measurement of what ``mean`` is the mean of."""
    if not has_same_shape(mean, other):
        return False
    white = difference(mean, other, factor)
    if white is None:
        return False
    # A third each: a difference spread over many parameters, one in a single one, one in an effect.
    share = AGREE / 3
    if joint_p(white, math.inf) < share or select(white, share, math.inf).chosen:
        return False
    z = _effect_scores(mean, other, factor)
    return not z or len(z) * two_sided(max(z), math.inf) >= share


def _effect_scores(one: Model, other: Model, factor: float) -> list[float]:
    """|z| of every effect's parameter whose uncertainty both know."""
    found = []
    for a, b in zip(_sorted(one), _sorted(other), strict=True):
        for name, was in a.parameters.items():
            now = b.parameters[name]
            spread = factor * math.hypot(was.std or 0.0, now.std or 0.0)
            if was.std is not None and now.std is not None and spread > 0:
                found.append(abs(_apart(name, was.value, now.value)) / spread)
    return found


def _apart(name: str, was: float, now: float) -> float:
    """now − was, the short way round for angles."""
    return math.remainder(now - was, 2 * math.pi) if name in ("phase", "angle") else now - was


def pool_agreeing(model: Model, earlier: Sequence[Model], factor: float) -> list[Model]:
    """Return ``model`` and the models before it that agree with it, oldest first; ``earlier`` is oldest
    first.
    """
    group = [model]
    for other in reversed(earlier):
        if len(group) == MOST or not agrees_with(pool_models(group), other, factor):
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
    group: list[Model] = []
    for model in history:
        mean = pool_models(group) if group else None
        white = None if mean is None else difference(mean, model)
        if white is not None:
            found.append(steady(white))
        goes_on = mean is not None and agrees_with(mean, model, factor)
        group = [*group, model][-MOST:] if goes_on else [model]
    return found


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
