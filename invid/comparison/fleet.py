"""Many cells over many runs: which parameter or cause of which cell left its own population.

Each cell is compared with its own runs since its last change; that cells differ is no news. Let x be a
parameter's value in a run and s the standard deviation that its fit states; what runs really scatter is
λ·s. λ² of one parameter of one cell has few degrees of freedom, but a fleet has many: λ² = (the parameter's
in the fleet)·(the cell's)·(what is left), the second from all parameters of the cell, the third from its own
scatter, each moderated by its distribution over the fleet, a scaled inverse χ² whose degrees of freedom are
estimated (Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3). Then

    t = (mean of the last m runs − mean before them) / (λ·√(1/Σw_last + 1/Σw_before)),   w = 1/s²,

is tested for m = 1 and m = 2: a change that one run does not show clearly, the next one does. All tests of
a cell in a run (parameters × two windows) share ``alpha`` (Holm): a run of one cell raises a false alarm with
that chance at most, however many parameters and runs there are. After an alarm the parameter's population
begins anew with the runs that raised it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from invid.comparison.causes import NAMED_FROM, main_parameter
from invid.comparison.pairs import name_of
from invid.errors import InputError
from invid.model.document import Model, parameter_vector, stds_by_name
from invid.numerics.arrays import Bool, Float64, frozen_float

ALPHA = 1e-3
"""False alarms in a run of a cell: one in a thousand cell-weeks."""
ENOUGH = 10
"""Variances from which the distribution of a parameter's λ² is estimated by itself: with fewer, those of all
parameters stand together. Empirical: d₀ from ten is within a factor of three (simulated)."""


@dataclass(frozen=True, eq=False)
class FleetHistory:
    """``value`` and ``std`` (W, C, P): runs in their order, cells, parameters; NaN where there is none."""

    cells: tuple[str, ...]
    parameters: tuple[str, ...]
    value: Float64
    std: Float64

    def __post_init__(self) -> None:
        shape = (self.value.shape[0], len(self.cells), len(self.parameters))
        if self.value.shape != shape or self.std.shape != shape:
            raise InputError(
                f"history of {len(self.cells)} cells and {len(self.parameters)} parameters: values have the "
                f"shape {self.value.shape}, standard deviations {self.std.shape}; both need {shape}"
            )


@dataclass(frozen=True)
class Departure:
    """A parameter of a cell that is not what it was: from run ``since`` on, told by ``seen``.

    ``before`` and ``after`` are means, ``std`` the standard deviation of their difference, ``p`` the chance
    of such a difference without a change, times the tests that were made on the cell in that run.
    """

    cell: str
    parameter: str
    since: int
    seen: int
    before: float
    after: float
    std: float
    p: float

    @property
    def sentence(self) -> str:
        """For a person."""
        return (
            f"{self.cell}: {self.parameter} left its own population in run {self.since + 1}: "
            f"{self.before:.5g} → {self.after:.5g} (± {self.std:.2g}, p {self.p:.1g})"
        )


@dataclass
class _Sums:
    """Σw, Σwx, Σwx², n of runs, (C, P) each."""

    w: Float64
    wx: Float64
    wxx: Float64
    n: Float64

    @classmethod
    def none(cls, shape: tuple[int, int]) -> _Sums:
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape))

    @classmethod
    def of(cls, x: Float64, w: Float64) -> _Sums:
        return cls(w, w * x, w * x**2, (w > 0).astype(float))

    def plus(self, other: _Sums) -> _Sums:
        return _Sums(self.w + other.w, self.wx + other.wx, self.wxx + other.wxx, self.n + other.n)

    def where(self, mask: Bool, other: _Sums) -> _Sums:
        """These, or the others where ``mask``."""
        pairs = ((self.w, other.w), (self.wx, other.wx), (self.wxx, other.wxx), (self.n, other.n))
        return _Sums(*(np.where(mask, b, a) for a, b in pairs))


def departures(history: FleetHistory, *, alpha: float = ALPHA) -> tuple[Departure, ...]:
    """All departures, in the order in which they were told."""
    return tuple(_departures(history, alpha))


def _departures(history: FleetHistory, alpha: float) -> Iterator[Departure]:
    runs, *rest = history.value.shape
    if not history.value.size:
        return
    shape = (rest[0], rest[1])
    # Values relative to the first of each, so that sums of squares keep their digits.
    known = np.isfinite(history.value) & (history.std > 0)
    first = np.argmax(known, axis=0)[None]
    origin = np.nan_to_num(np.take_along_axis(history.value, first, axis=0)[0])
    before, last = _Sums.none(shape), _Sums.none(shape)
    last_run = np.full(shape, -1)
    scatter = _CellScatter(shape[0])
    for run in range(runs):
        now = known[run]
        x = np.where(now, history.value[run] - origin, 0.0)
        w = np.where(now, 1.0 / np.where(now, history.std[run], 1.0) ** 2, 0.0)
        one = _Sums.of(x, w)
        tests = [(before.plus(last), one), (before, last.plus(one))]
        found = [_t_test(base, window, now & (base.n > 0), scatter) for base, window in tests]
        found[1] = [np.where(last.n > 0, a, b) for a, b in zip(found[1], (1.0, 0.0, np.inf), strict=True)]
        p = np.minimum(1.0, 2.0 * np.minimum(found[0][0], found[1][0]))
        alarm, adjusted = _holm(np.where(now, p, np.nan), alpha)
        both = alarm & (found[1][0] < found[0][0])
        for c, k in zip(*np.nonzero(alarm), strict=True):
            m = int(both[c, k])
            base = tests[m][0]
            mean = base.wx[c, k] / base.w[c, k]
            yield Departure(
                history.cells[c],
                history.parameters[k],
                since=int(last_run[c, k]) if m else run,
                seen=run,
                before=float(mean + origin[c, k]),
                after=float(mean + found[m][1][c, k] + origin[c, k]),
                std=float(found[m][2][c, k]),
                p=float(adjusted[c, k]),
            )
        scatter.add(tests[0][0], one, now & ~alarm)
        nothing = _Sums.none(shape)
        moved = before.plus(last).where(alarm, last).where(alarm & ~both, nothing)
        before = before.where(now, moved)
        last = last.where(now, one)
        last_run = np.where(now, run, last_run)


class _CellScatter:
    """How much more or less each cell scatters than the fleet, from its runs so far.

    A run's mean over the parameters of (difference from the mean before)²/(variance at the fleet's λ) is one
    draw. Estimates of one run are correlated, so a draw has fewer degrees of freedom than parameters: what
    the draws of one cell scatter tells how many.
    """

    def __init__(self, cells: int) -> None:
        self.sum, self.squares, self.count = np.zeros(cells), np.zeros(cells), np.zeros(cells)

    def add(self, base: _Sums, window: _Sums, usable: Bool) -> None:
        """One run of all cells; parameters that raised an alarm are not ``usable``."""
        scale = _fleet_variance(*_variance(base))[0]
        ready = usable & (base.n >= 2) & (window.w > 0)
        difference = np.where(ready, window.wx / np.where(ready, window.w, 1.0) - _mean(base), 0.0)
        spread = 1.0 / np.where(ready, window.w, 1.0) + 1.0 / np.where(ready, base.w, 1.0)
        count = ready.sum(axis=1)
        draw = np.sum(difference**2 / spread / scale, axis=1) / np.maximum(count, 1)
        seen = (count > 0) & (draw > 0)
        self.sum += np.where(seen, draw, 0.0)
        self.squares += np.where(seen, draw**2, 0.0)
        self.count += seen

    def moderated(self) -> tuple[Float64, Float64]:
        """(C,) factor on λ² and its degrees of freedom; 1 and infinite where too few cells tell."""
        known = self.count >= 2
        if known.sum() < ENOUGH:
            return np.ones_like(self.sum), np.full_like(self.sum, np.inf)
        mean = self.sum / np.maximum(self.count, 1.0)
        within = (self.squares - self.count * mean**2)[known] / mean[known] ** 2
        a_draw = 2.0 / max(float(within.sum() / (self.count[known] - 1.0).sum()), 1e-6)
        dof = a_draw * self.count
        scale, prior = _scaled_inverse_chi2(mean[known], dof[known])
        if math.isinf(prior):
            return np.full_like(mean, scale), np.full_like(mean, np.inf)
        return (prior * scale + dof * mean) / (prior + dof), prior + dof


def _mean(sums: _Sums) -> Float64:
    result: Float64 = sums.wx / np.where(sums.w > 0, sums.w, 1.0)
    return result


def _variance(sums: _Sums) -> tuple[Float64, Float64]:
    """λ² of each cell and parameter by its own runs, and its degrees of freedom."""
    dof = np.maximum(sums.n - 1.0, 0.0)
    squares = np.maximum(sums.wxx - sums.wx * _mean(sums), 0.0)
    return squares / np.maximum(dof, 1.0), dof


def _t_test(base: _Sums, window: _Sums, usable: Bool, scatter: _CellScatter) -> list[Float64]:
    """p, difference and its standard deviation of each cell and parameter; p = 1 where it cannot be told."""
    variance, dof = _variance(base)
    cell, cell_dof = scatter.moderated()
    scale, prior = _fleet_variance(variance / cell[:, None], dof)
    known = np.isinf(prior)
    finite = np.where(known, 0.0, prior)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = (finite * scale + dof * variance / cell[:, None]) / (finite + dof)
        moderated = cell[:, None] * np.where(known, scale, own)
        # Relative variances 2/dof of both estimates add up.
        total = 1.0 / (1.0 / np.where(known, np.inf, finite + dof) + 1.0 / cell_dof[:, None])
        inside = np.where(window.w > 0, window.w, 1.0)
        difference = window.wx / inside - _mean(base)
        std = np.sqrt(moderated * (1.0 / inside + 1.0 / np.where(base.w > 0, base.w, 1.0)))
        t = np.abs(difference) / std
        tail = np.where(np.isinf(total), special.ndtr(-t), special.stdtr(np.minimum(total, 1e6), -t))
    ready = usable & (total > 0) & (window.w > 0) & (std > 0)
    return [np.where(ready, 2.0 * tail, 1.0), difference, std]


def _fleet_variance(variance: Float64, dof: Float64) -> tuple[Float64, Float64]:
    """(P,) scale s₀² and degrees of freedom d₀ of the fleet's λ²; d₀ = 0 where there are too few to tell."""
    usable = (dof >= 1.0) & (variance > 0.0)
    every = _scaled_inverse_chi2(variance[usable], dof[usable]) if usable.sum() >= ENOUGH else (1.0, 0.0)
    found = [
        _scaled_inverse_chi2(v[u], d[u]) if u.sum() >= ENOUGH else every
        for v, d, u in zip(variance.T, dof.T, usable.T, strict=True)
    ]
    return np.array([f[0] for f in found]), np.array([f[1] for f in found])


def _scaled_inverse_chi2(variance: Float64, dof: Float64) -> tuple[float, float]:
    """Scale and degrees of freedom by the mean and variance of log λ² (Smyth's equations 9 and 10)."""
    e = np.log(variance) - special.digamma(dof / 2) + np.log(dof / 2)
    mean = float(e.mean())
    excess = float(np.sum((e - mean) ** 2) / (e.size - 1) - special.polygamma(1, dof / 2).mean())
    if excess <= 0:
        return math.exp(mean), math.inf
    prior = 2.0 * _trigamma_inverse(excess)
    return math.exp(mean + float(special.digamma(prior / 2)) - math.log(prior / 2)), prior


def _trigamma_inverse(value: float) -> float:
    """y with ψ′(y) = value, by Newton's method on 1/ψ′, which is nearly straight (Smyth's appendix)."""
    y = 0.5 + 1.0 / value
    for _ in range(50):
        trigamma = float(special.polygamma(1, y))
        step = trigamma * (1.0 - trigamma / value) / float(special.polygamma(2, y))
        y += step
        if -step / y < 1e-10:
            break
    return y


def _holm(p: Float64, alpha: float) -> tuple[Bool, Float64]:
    """Rejections and adjusted p over the parameters of each cell (rows); NaN is no test."""
    order = np.argsort(np.where(np.isnan(p), np.inf, p), axis=1)
    count = np.sum(~np.isnan(p), axis=1, keepdims=True)
    rank = np.arange(p.shape[1])[None]
    ordered = np.take_along_axis(p, order, axis=1) * np.maximum(count - rank, 1)
    ordered = np.maximum.accumulate(np.where(np.isnan(ordered), np.inf, ordered), axis=1)
    adjusted = np.empty_like(ordered)
    np.put_along_axis(adjusted, order, np.minimum(ordered, 1.0), axis=1)
    adjusted = np.where(np.isnan(p), 1.0, adjusted)
    return adjusted <= alpha, adjusted


@dataclass(frozen=True)
class RunSizes:
    """One run of one cell: value and standard deviation by name, and which of these are causes."""

    sizes: Mapping[str, tuple[float, float]]
    causes: frozenset[str]


def run_sizes(model: Model) -> RunSizes:
    """Linear parameters and the size of each cause, where their standard deviations are known."""
    stds = stds_by_name(model)
    found = {n: (float(v), stds[n]) for n, v in zip(*parameter_vector(model.chains), strict=True)}
    causes = set()
    for term in model.effects:
        main = main_parameter(term)
        if main is not None and term.parameters[main].std:
            size = term.parameters[main]
            found[name_of(term)] = (size.value, float(size.std or math.nan))
            causes.add(name_of(term))
    return RunSizes({n: s for n, s in found.items() if s[1] > 0}, frozenset(causes))


def fleet_history(runs: Mapping[str, Sequence[Model | RunSizes]]) -> FleetHistory:
    """The history of cells from their models, oldest first.

    A cause that a cell shows in some runs was too small to be named in the others, not nothing: there it is 0
    with the standard deviation of a size that is anything up to the one from which causes are named.
    """
    sized = [[r if isinstance(r, RunSizes) else run_sizes(r) for r in own] for own in runs.values()]
    names = sorted({name for own in sized for run in own for name in run.sizes})
    shape = (max((len(own) for own in sized), default=0), len(sized), len(names))
    value, std = np.full(shape, np.nan), np.full(shape, np.nan)
    place = {name: k for k, name in enumerate(names)}
    for c, own in enumerate(sized):
        for t, run in enumerate(own):
            for name, (x, s) in run.sizes.items():
                value[t, c, place[name]], std[t, c, place[name]] = x, s
        for name in {name for run in own for name in run.causes}:
            k, few = place[name], slice(len(own))
            spread = float(np.nanmedian(std[few, c, k]))
            absent = np.isnan(value[few, c, k])
            value[few, c, k] = np.where(absent, 0.0, value[few, c, k])
            std[few, c, k] = np.where(absent, NAMED_FROM * spread / math.sqrt(3.0), std[few, c, k])
    return FleetHistory(tuple(runs), tuple(names), frozen_float(value), frozen_float(std))
