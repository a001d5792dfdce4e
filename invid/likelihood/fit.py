"""The complete fit of one structure: starts, nuisances, weights, covariance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from invid.errors import NotIdentifiableError
from invid.likelihood.covariance import parameter_std, physical_covariance
from invid.likelihood.excess_variance import excess_variance
from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.nuisance.gradual_reversals import fit_gradual_reversals
from invid.likelihood.nuisance.hold_timing import free_hold_locations, gains_beyond_range, locate_holds
from invid.likelihood.nuisance.reversals import fit_sharp_reversals
from invid.likelihood.nuisance.torque_lags import (
    COULOMB,
    COULOMB_SIGMA,
    TORQUE_LAG,
    add_coulomb_columns,
    fit_reversal_lags,
    fit_torque_lags,
)
from invid.likelihood.records import add_columns, problem_from_spectra, transfer_parameters
from invid.likelihood.residual import MissingTorqueProblem
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectra import LineSpectra

SIGNIFICANCE = 1e-3
"""Significance at which boundary terms are added (statistical: wrong once in a thousand settled records)."""


NOISE_SHARES = (0.1, 0.03, 0.01, 0.003)
"""Shares of every amplitude that count as noise while a start is led to its minimum. Empirical: under the
sensors' noise alone a start 12 % off in one spring of a chain of five ends in another minimum; a tenth of the
amplitude widens the valley, and each step starts within the next."""

SAME_MINIMUM = 1e-3
"""Relative difference of χ² up to which two starts have ended in the same minimum (numerical)."""

AT_NOISE = 1.5
"""χ²/ν up to which a fit counts as at its noise and no further start is tried (empirical)."""
MOST_MODERATE = 300
"""Modes times motors squared above which a plant is large. Empirical: four branches of five masses take
seconds, six of five were cut short after six minutes."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted structure.

    ``covariance`` (n, n) is of the structure's parameters in physical units, inflated where χ² says so;
    ``names`` name them. ``noise_chi2`` is χ²/ν against the sensors' noise alone; ``solution.reduced`` is χ²/ν
    after the excess got a variance.
    """

    problem: MissingTorqueProblem
    solution: Solution
    structure: ChainStructure
    chains: CoupledChains
    covariance: Float64
    noise_chi2: float
    noise_cost: float
    explained: float
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the structure's parameters."""
        return self.structure.names

    @property
    def values(self) -> Float64:
        """(n,) the structure's parameters in physical units."""
        return self.structure.physical(self.solution.p[: self.structure.count])


class FreeAnswer(Protocol):
    """What a linear model without structure reaches on the records."""

    def misses_too(self) -> bool:
        """Whether it misses far more than noise as well: something acts that no linear structure holds."""
        ...

    def is_no_better(self, problem: MissingTorqueProblem, solution: Solution) -> bool:
        """Whether it misses as much as a fit."""
        ...


def fit_structure(
    spectra: Sequence[LineSpectra],
    structure: ChainStructure,
    starts: Iterable[CoupledChains],
    *,
    thorough: bool = True,
    free: FreeAnswer | None = None,
) -> Fit:
    """Maximum-likelihood fit of ``structure`` from the best of several starts.

    ``thorough=False`` stops after the first pass (for comparing structures). ``free``: what an FRF without
    structure reaches, asked where a start is far above the noise.
    """
    problem = add_coulomb_columns(problem_from_spectra(structure, spectra), spectra)
    if problem.dof <= 0:
        rows = sum(2 * b.position.size for b in problem.blocks)
        raise NotIdentifiableError(
            f"{sum(b.omega.size for b in problem.blocks)} lines give {rows} equations for "
            f"{rows - problem.dof} unknowns: lengthen the period, widen the band, or use fewer masses"
        )
    # A large plant's further starts take longer than a search on from the first.
    patience = 1 if is_costly_to_start(structure.sizes) else 5 if thorough else 2
    problem, solution = _fit_best_start(problem, starts, spectra, 80 if thorough else 30, patience, free)
    holds: dict[str, str] = {}
    budget.tell("identifying", 0.6 if thorough else 0.3)
    if thorough and not budget.is_left_out("transients, holds, inner friction and lags of the model"):
        problem, solution = _add_boundary_terms(problem, solution, spectra)
        problem, solution = fit_sharp_reversals(problem, solution, spectra)
    problem, solution = fit_gradual_reversals(problem, solution, spectra)
    if thorough:
        problem, solution, holds = locate_holds(problem, solution, spectra)
        problem, solution = _fit_inner_friction(problem, solution)
        problem, solution = fit_torque_lags(problem, solution)
    base = [b.noise for b in problem.blocks]
    noise_chi2, noise_cost = solution.reduced, solution.chi2
    excess: list[Float64] = []
    budget.tell("identifying", 0.8 if thorough else 0.3)
    if thorough:
        problem, solution, excess = _fit_excess_variance(problem, solution, base)
        plain = problem.with_noise(base)
        unweighted = solution if budget.is_spent() else gauss_newton(plain, solution.p)
        if unweighted.chi2 < 0.9 * noise_cost:
            # The weights led out of a wrong minimum: what is left beyond the noise is to be judged anew.
            noise_chi2, noise_cost = unweighted.reduced, unweighted.chi2
            problem, solution, excess = _fit_excess_variance(plain, unweighted, base)
        problem, solution, excess = _drop_coulomb(problem, solution, base, excess)
        problem, solution = fit_reversal_lags(problem, solution)
    problem, solution, open_holds, early_holds = free_hold_locations(problem, solution, spectra, holds)
    budget.tell("identifying", 0.95 if thorough else 0.3)
    unbounded = physical_covariance(problem, solution)
    is_bounded = bool(gains_beyond_range(problem, solution))
    problem, solution = _fit_within_bounds(problem, solution)
    # A hold that is kept in its range is known no better for that.
    covariance = unbounded if is_bounded else physical_covariance(problem, solution)
    # A damper held at zero keeps the standard deviation it had when free.
    pinned = np.flatnonzero(~solution.free[: problem.structure.count])
    covariance[pinned, pinned] = np.diag(unbounded)[pinned]
    timing = {
        axis: float(np.sqrt(covariance[dof, dof]))
        for axis, dof in zip(structure.axes, structure.motor_dofs, strict=True)
        if axis in open_holds
    }
    explained = _explained_share(problem, solution)
    return Fit(
        problem,
        solution,
        problem.structure,
        problem.structure.chains(solution.p[: problem.structure.count]),
        covariance,
        noise_chi2,
        noise_cost,
        explained,
        {**_facts(problem, solution, excess), "holds": {**holds, **early_holds}, "hold_timing": timing},
    )


def is_costly_to_start(sizes: Sequence[int]) -> bool:
    """Whether a start for this plant takes longer than a fit from it."""
    return (sum(sizes) - len(sizes)) * len(sizes) ** 2 > MOST_MODERATE


def _fit_best_start(
    problem: MissingTorqueProblem,
    starts: Iterable[CoupledChains],
    spectra: Sequence[LineSpectra],
    iterations: int,
    patience: int,
    free: FreeAnswer | None,
) -> tuple[MissingTorqueProblem, Solution]:
    """The problem, with the friction columns of its best fit, and the solution of lowest cost from all
    starts.

    Stops at the first start that reaches the noise, or where a second start leads to the same minimum as the
    best one, or where ``free`` misses as much: that is no other start's. The width of
    friction reversals is fitted after each: with a sign that is too sharp a mode hides
    behind what friction leaves, and no start would reach the noise.
    """
    best: Solution | None = None
    for number, p in enumerate(_ordered_starts(problem, starts, patience, free)):
        if best is not None and budget.is_left_out("further starts of the identification"):
            break
        budget.tell(f"identifying, start {number + 1}", 0.5 * (1.0 - 0.5**number))
        for share in NOISE_SHARES[1:]:
            p = gauss_newton(tempered(problem, share), p, iterations=15, tolerance=0.1).p
        with_reversals, found = fit_gradual_reversals(
            problem, gauss_newton(problem, p, iterations=iterations), spectra
        )
        is_repeated = best is not None and abs(found.chi2 - best.chi2) < SAME_MINIMUM * best.chi2
        if best is None or found.chi2 < best.chi2:
            problem, best = with_reversals, found
        if is_repeated or best.reduced < AT_NOISE or (free is not None and free.is_no_better(problem, best)):
            break
    if best is None:
        raise NotIdentifiableError(
            "no start for the fit: no frequency at which all axes are excited; excite every axis, one an "
            "experiment or all at once"
        )
    return problem, best


def _ordered_starts(
    problem: MissingTorqueProblem,
    starts: Iterable[CoupledChains],
    patience: int,
    free: FreeAnswer | None,
) -> Iterator[Float64]:
    """(n,) parameters from the starts, fitted with the largest ``NOISE_SHARES``; those that miss more than it
    come last, and not at all where another one did not.

    A further fit from those costs most, and nearly always ends in another minimum. After ``patience`` such
    starts it is the machine and not the start: then the best of them comes first. So it is at once where an
    FRF without structure misses as well.
    """
    wide = tempered(problem, NOISE_SHARES[0])
    postponed: list[Solution] = []
    is_patience_spent = is_near = False
    for start in starts:
        if postponed and budget.is_spent():
            break
        p = problem.start(problem.structure.vector(start))
        found = gauss_newton(wide, p, iterations=15, tolerance=0.1)
        is_near = is_near or found.reduced < 1.0
        if found.reduced < 1.0 or (is_patience_spent and not is_near):
            yield found.p
            continue
        if is_near:
            continue
        postponed.append(found)
        if len(postponed) == patience or (free is not None and free.misses_too()):
            yield from (s.p for s in sorted(postponed, key=lambda s: s.chi2))
            postponed, is_patience_spent = [], True
    yield from (s.p for s in sorted(postponed, key=lambda s: s.chi2) if not is_near)


def tempered(problem: MissingTorqueProblem, share: float) -> MissingTorqueProblem:
    """The problem with a share of every amplitude as further noise."""
    noise = []
    for block in problem.blocks:
        power = np.abs(np.concatenate((block.position, block.torque), axis=1)) ** 2
        noise.append(block.noise + share**2 * power)
    return problem.with_noise(noise)


def _add_boundary_terms(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution]:
    """Problem and solution with boundary terms for periodic records whose transient is significant."""
    flags = [b.transient for b in problem.blocks]
    count = 2 * problem.structure.dofs
    for number, block in enumerate(problem.blocks):
        rows = 2 * block.position.size
        if block.transient or rows < 3 * count:
            continue
        single = replace(problem, blocks=(block,))
        with_boundary = replace(problem, blocks=(replace(block, transient=True),))
        plain, _ = single.evaluate(solution.p)
        with_terms, _ = with_boundary.evaluate(solution.p)
        before, after = float(plain[:rows] @ plain[:rows]), float(with_terms[:rows] @ with_terms[:rows])
        # Scaled by the residual with the terms: unmodelled friction must not look like a transient.
        gain = (before - after) / max(after / (rows - count), 1.0)
        flags[number] = bool(gain > chi2_isf(SIGNIFICANCE, count))
    if flags == [b.transient for b in problem.blocks]:
        return problem, solution
    with_boundary = add_coulomb_columns(
        problem_from_spectra(problem.structure, spectra, boundary=flags), spectra
    )
    return with_boundary, gauss_newton(with_boundary, transfer_parameters(problem, solution.p, with_boundary))


def _fit_inner_friction(
    problem: MissingTorqueProblem, solution: Solution
) -> tuple[MissingTorqueProblem, Solution]:
    """Viscous friction of the masses beyond the motor, where the data ask for it.

    A bearing at the load shifts the antiresonance that the load's mass is read from.
    """
    structure = problem.structure
    if structure.inner_viscous or not structure.inner_dofs:
        return problem, solution
    larger = replace(problem, structure=replace(structure, inner_viscous=True))
    found = gauss_newton(larger, transfer_parameters(problem, solution.p, larger))
    extra = len(structure.inner_dofs)
    scale = max(found.reduced, 1.0)
    part = slice(structure.slices["viscous"].stop, structure.slices["viscous"].stop + extra)
    positive = found.p[part] > -3.0 * parameter_std(found)[part]
    if (solution.chi2 - found.chi2) / scale > chi2_isf(SIGNIFICANCE, extra) and positive.all():
        return larger, found
    return problem, solution


def _fit_excess_variance(
    problem: MissingTorqueProblem, solution: Solution, base: list[Float64]
) -> tuple[MissingTorqueProblem, Solution, list[Float64]]:
    """Problem, solution and excess after refits with the residual beyond noise as a variance, until they
    settle."""
    excess: list[Float64] = [np.zeros(b.position.shape) for b in problem.blocks]
    for _ in range(6):
        noise, new = excess_variance(problem, solution, base)
        problem = problem.with_noise(noise)
        if not any(e.any() for e in new) and not any(e.any() for e in excess):
            return problem, solution, new
        before = solution.p
        solution = gauss_newton(problem, solution.p)
        excess = new
        if budget.is_spent():
            break
        moved = np.abs(solution.p - before)[solution.free]
        if np.all(moved < 0.1 * parameter_std(solution)[solution.free]):
            break
    return problem, solution, excess


def _drop_coulomb(
    problem: MissingTorqueProblem, solution: Solution, base: list[Float64], excess: list[Float64]
) -> tuple[MissingTorqueProblem, Solution, list[Float64]]:
    """The fit without Coulomb coefficients that are not significant, or that would drive the motion."""
    part = problem.slices["column"]
    if part.start == part.stop:
        return problem, solution, excess
    keep = solution.p[part] > COULOMB_SIGMA * parameter_std(solution)[part]
    keep = keep | np.array([not n.endswith(COULOMB) for n in problem.column_names])
    if keep.all():
        return problem, solution, excess
    names = tuple(n for n, k in zip(problem.column_names, keep, strict=True) if k)
    reduced = add_columns(problem, [b.columns[:, :, keep] for b in problem.blocks], names)
    solution = gauss_newton(reduced, transfer_parameters(problem, solution.p, reduced))
    return _fit_excess_variance(reduced, solution, base)


def _fit_within_bounds(
    problem: MissingTorqueProblem, solution: Solution
) -> tuple[MissingTorqueProblem, Solution]:
    """The fit with negative dampers and viscous friction at zero and gains of open holds within their range.

    A viscous friction that is negative by more than three standard deviations stays: something else causes
    it, and hiding that would bias the rest.
    """
    structure = problem.structure
    dampers, viscous = structure.slices["damper"], structure.slices["viscous"]
    for _ in range(3):
        spread = parameter_std(solution)
        pinned = [
            k
            for k in (*range(dampers.start, dampers.stop), *range(viscous.start, viscous.stop))
            if solution.free[k]
            and solution.p[k] < 0
            and (k < dampers.stop or solution.p[k] > -3.0 * spread[k])
        ]
        ends = dict.fromkeys(pinned, 0.0) | gains_beyond_range(problem, solution)
        if not ends:
            break
        problem = replace(problem, fixed=(*problem.fixed, *(problem.names[k] for k in ends)))
        start = solution.p.copy()
        start[list(ends)] = list(ends.values())
        solution = gauss_newton(problem, start)
    return problem, solution


def _explained_share(problem: MissingTorqueProblem, solution: Solution) -> float:
    """Explained share, 0 … 1, of the noise-weighted torque power."""
    left = total = 0.0
    for state in problem.states(solution.p):
        weight = 1.0 / np.maximum(np.einsum("fii->fi", state.covariance).real, 1e-300)
        left += float((np.abs(state.residual) ** 2 * weight).sum())
        total += float((np.abs(state.block.torque) ** 2 * weight).sum())
    return max(0.0, 1.0 - left / max(total, 1e-300))


def _time_constants(delays: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Time constants [s] of torque channels by axis from their squares; negative where the position lags."""
    out = {}
    for name, square in delays.items():
        if name.endswith(TORQUE_LAG):
            tau = float(np.sqrt(abs(square["value"])))
            std = square["std"] / (2.0 * tau) if tau > 0 else np.inf
            out[name.removesuffix(TORQUE_LAG)] = {
                "value": float(np.copysign(tau, square["value"])),
                "std": std,
            }
    return out


def _facts(problem: MissingTorqueProblem, solution: Solution, excess: list[Float64]) -> dict[str, Any]:
    spread = parameter_std(solution)
    s = problem.slices

    def entries(part: slice) -> dict[str, dict[str, float]]:
        return {
            problem.names[k]: {"value": float(solution.p[k]), "std": float(spread[k])}
            for k in range(part.start, part.stop)
            if solution.free[k]
        }

    viscous = problem.structure.slices["viscous"]
    motors = problem.structure.motors
    friction = {k: v for k, v in entries(s["column"]).items() if k.endswith(COULOMB)}
    return {
        "result": solution.result,
        "iterations": solution.iterations,
        "chi2": solution.chi2,
        "dof": solution.dof,
        "time_offset_s": {k: v for k, v in entries(s["delay"]).items() if not k.endswith(TORQUE_LAG)},
        "torque_lag_s": _time_constants(entries(s["delay"])),
        "held_over_sample": entries(s["staircase"]),
        "friction": {**friction, **entries(viscous)},
        "boundary_terms": [b.key for b in problem.blocks if b.transient],
        "excess_torque": {
            b.key: [float(np.sqrt(e[:, i].mean())) for i in range(motors)]
            for b, e in zip(problem.blocks, excess, strict=False)
            if e.any()
        },
    }
