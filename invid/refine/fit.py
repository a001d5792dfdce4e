"""The whole fit of one structure: starts, nuisances, weights, covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from invid.arrays import Complex128, Float64
from invid.chains import CoupledChains
from invid.refine.blocks import carried, problem_from_spectra, used_lines, with_columns
from invid.refine.friction import coulomb_columns
from invid.refine.problem import MissingTorqueProblem
from invid.refine.solver import Solution, gauss_newton
from invid.refine.structure import ChainStructure
from invid.refine.weights import excess_variance
from invid.spectra import LineSpectra

NEEDED = 1e-3
"""Significance at which boundary terms are added: wrong once in a thousand settled records."""
COULOMB_SIGMA = 4.0
"""Standard deviations (excess variance included) below which Coulomb friction leaves the fit."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted structure.

    ``covariance`` (n, n) is of the structure's parameters in physical units, inflated where χ² says
    so; ``names`` name them. ``noise_chi2`` is χ²/ν against the sensors' noise alone: what the model
    leaves, in units of the noise; ``solution.reduced`` is after the excess got a variance.
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
        """Structure's parameters in physical units."""
        return self.structure.physical(self.solution.p[: self.structure.count])


def fit_structure(
    spectra: Sequence[LineSpectra],
    structure: ChainStructure,
    starts: Sequence[CoupledChains],
    *,
    thorough: bool = True,
) -> Fit:
    """Maximum-likelihood fit of ``structure`` from the best of several starts.

    ``thorough=False`` stops after the first pass (for comparing structures).
    """
    problem = _with_coulomb(problem_from_spectra(structure, spectra), spectra)
    solution = _best(problem, starts)
    if thorough:
        problem, solution = _holds(problem, solution)
        problem, solution = _boundary(problem, solution, spectra)
    base = [b.covariance for b in problem.blocks]
    noise_chi2, noise_cost = solution.reduced, solution.chi2
    problem, solution, excess = _weighted(problem, solution, base)
    if thorough:
        problem, solution, excess = _drop_coulomb(problem, solution, base, excess)
    covariance = physical_covariance(problem, solution)
    explained = _explained(problem, solution)
    return Fit(
        problem,
        solution,
        structure,
        structure.chains(solution.p[: structure.count]),
        covariance,
        noise_chi2,
        noise_cost,
        explained,
        _facts(problem, solution, excess, base),
    )


def physical_covariance(problem: MissingTorqueProblem, solution: Solution) -> Float64:
    """(n, n) covariance of the structure's parameters in physical units, inflated by χ²/ν > 1.

    Directions that the data do not see (singular values below 1e-9 of the largest, columns scaled)
    get an infinite variance on every parameter they move by more than a hundredth.
    """
    full = np.zeros((solution.p.size, solution.p.size))
    free = np.flatnonzero(solution.free)
    scale = np.linalg.norm(solution.jacobian, axis=0)
    blind = scale == 0
    scale[blind] = 1.0
    _, size, right = np.linalg.svd(solution.jacobian / scale, full_matrices=False)
    seen = size > 1e-9 * size[0]
    inverse = (right[seen].T / size[seen] ** 2) @ right[seen] / scale[:, None] / scale
    lost = np.flatnonzero(blind | (np.abs(right[~seen]) > 1e-2).any(axis=0))
    inverse[lost, lost] = np.inf
    full[np.ix_(free, free)] = inverse * max(1.0, solution.reduced)
    count = problem.structure.count
    values = problem.structure.physical(solution.p[:count])
    factor = np.where(problem.structure.logarithmic, values, 1.0)
    with np.errstate(invalid="ignore"):
        result: Float64 = full[:count, :count] * factor[:, None] * factor
    return result


def _with_coulomb(problem: MissingTorqueProblem, spectra: Sequence[LineSpectra]) -> MissingTorqueProblem:
    """One Coulomb coefficient for each axis that moves clearly in some record."""
    motors = problem.structure.motors
    found = [coulomb_columns(s) for s in spectra]
    axes = [i for i in range(motors) if any(bool(moves[i]) for _, moves in found)]
    columns = []
    for (spectrum, moves), s, block in zip(found, spectra, problem.blocks, strict=True):
        used = used_lines(s, everything=block.omega.size != int(s.excited.sum()))
        part = np.zeros((int(used.sum()), motors, len(axes)), dtype=complex)
        for at, i in enumerate(axes):
            if moves[i]:
                part[:, i, at] = spectrum[used, i]
        columns.append(part)
    return with_columns(problem, columns, [f"{problem.structure.axes[i]}.coulomb" for i in axes])


def _best(problem: MissingTorqueProblem, starts: Sequence[CoupledChains]) -> Solution:
    """The lowest cost from all starts; stops at the first that cannot be told from noise."""
    best: Solution | None = None
    for start in starts:
        found = gauss_newton(problem, problem.start(problem.structure.vector(start)))
        if best is None or found.chi2 < best.chi2:
            best = found
        if best.reduced < 1.5:
            break
    if best is None:
        raise ValueError("fit_structure needs at least one start")
    return best


def _holds(problem: MissingTorqueProblem, solution: Solution) -> tuple[MissingTorqueProblem, Solution]:
    """Whether a driven axis keeps its hold: decided by the data, axis by axis together.

    Torque of a position loop inside the drive is continuous where the command is held over the
    sample; while the axis is driven, either both act or the command alone.
    """
    names = problem.share_names
    if not names:
        return problem, solution
    best: tuple[float, MissingTorqueProblem, Solution] | None = None
    choices = (
        list(product((0.0, 1.0), repeat=len(names)))
        if len(names) <= 2
        else [
            (0.0,) * len(names),
            (1.0,) * len(names),
        ]
    )
    part = problem.slices["share"]
    for choice in choices:
        fixed = replace(problem, fixed=(*problem.fixed, *names))
        start = solution.p.copy()
        start[part] = choice
        found = gauss_newton(fixed, start)
        if best is None or found.chi2 < best[0]:
            best = (found.chi2, fixed, found)
    if best is None:
        return problem, solution
    return best[1], best[2]


def _boundary(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution]:
    """Boundary terms for periodic records whose transient has not died: where they pay for themselves."""
    blocks = list(problem.blocks)
    changed = False
    count = 2 * problem.structure.dofs
    for number, block in enumerate(blocks):
        if block.transient or 2 * block.position.size < 3 * count:
            continue
        alone = replace(problem, blocks=(block,))
        freed = replace(problem, blocks=(replace(block, transient=True),))
        rows = 2 * block.position.size
        plain, _ = alone.evaluate(solution.p)
        with_terms, _ = freed.evaluate(solution.p)
        before, after = float(plain[:rows] @ plain[:rows]), float(with_terms[:rows] @ with_terms[:rows])
        # The scale is what is left with the terms in: friction that is left must not look like one.
        gain = (before - after) / max(after / (rows - count), 1.0)
        if gain > chi2_distribution.isf(NEEDED, count):
            blocks[number] = replace(block, transient=True)
            changed = True
    if not changed:
        return problem, solution
    freed = replace(problem, blocks=tuple(blocks))
    return freed, gauss_newton(freed, solution.p)


def _weighted(
    problem: MissingTorqueProblem, solution: Solution, base: list[Complex128]
) -> tuple[MissingTorqueProblem, Solution, list[Float64]]:
    """Refit with what is left beyond the noise as a variance of its own, until it stands."""
    excess: list[Float64] = [np.zeros(b.position.shape) for b in problem.blocks]
    for _ in range(6):
        covariances, new = excess_variance(problem, solution, base)
        problem = problem.with_covariance(covariances)
        if not any(e.any() for e in new) and not any(e.any() for e in excess):
            return problem, solution, new
        before = solution.p
        solution = gauss_newton(problem, solution.p)
        excess = new
        moved = np.abs(solution.p - before)[solution.free]
        scale = np.sqrt(np.maximum(np.diag(np.linalg.pinv(solution.jacobian.T @ solution.jacobian)), 0.0))
        if np.all(moved < 0.1 * scale):
            break
    return problem, solution, excess


def _drop_coulomb(
    problem: MissingTorqueProblem, solution: Solution, base: list[Complex128], excess: list[Float64]
) -> tuple[MissingTorqueProblem, Solution, list[Float64]]:
    """Leaves out Coulomb coefficients that the data do not ask for, or that would drive the motion."""
    part = problem.slices["column"]
    if part.start == part.stop:
        return problem, solution, excess
    spread = np.sqrt(np.diag(np.linalg.pinv(solution.jacobian.T @ solution.jacobian)))
    full = np.full(solution.p.size, np.inf)
    full[solution.free] = spread * np.sqrt(max(1.0, solution.reduced))
    keep = solution.p[part] > COULOMB_SIGMA * full[part]
    if keep.all():
        return problem, solution, excess
    names = tuple(n for n, k in zip(problem.column_names, keep, strict=True) if k)
    reduced = with_columns(problem, [b.columns[:, :, keep] for b in problem.blocks], names)
    solution = gauss_newton(reduced, carried(problem, solution.p, reduced))
    return _weighted(reduced, solution, base)


def _explained(problem: MissingTorqueProblem, solution: Solution) -> float:
    """Share of the (noise-weighted) torque power that the model accounts for, 0 … 1."""
    left = total = 0.0
    for state in problem.states(solution.p):
        weight = 1.0 / np.maximum(np.einsum("fii->fi", state.covariance).real, 1e-300)
        left += float((np.abs(state.residual) ** 2 * weight).sum())
        total += float((np.abs(state.block.torque) ** 2 * weight).sum())
    return max(0.0, 1.0 - left / max(total, 1e-300))


def _facts(
    problem: MissingTorqueProblem, solution: Solution, excess: list[Float64], base: list[Complex128]
) -> dict[str, Any]:
    spread = np.full(solution.p.size, np.nan)
    spread[solution.free] = np.sqrt(
        np.maximum(np.diag(np.linalg.pinv(solution.jacobian.T @ solution.jacobian)), 0.0)
        * max(1.0, solution.reduced)
    )
    s = problem.slices

    def listed(part: slice) -> dict[str, dict[str, float]]:
        return {
            problem.names[k]: {"value": float(solution.p[k]), "std": float(spread[k])}
            for k in range(part.start, part.stop)
            if solution.free[k]
        }

    viscous = problem.structure.slices["viscous"]
    motors = problem.structure.motors
    return {
        "result": solution.result,
        "iterations": solution.iterations,
        "chi2": solution.chi2,
        "dof": solution.dof,
        "time_offset_s": listed(s["delay"]),
        "held_over_sample": listed(s["staircase"]),
        "hold_while_driven": {
            name: float(solution.p[s["share"]][k]) for k, name in enumerate(problem.share_names)
        },
        "friction": {**listed(s["column"]), **listed(viscous)},
        "boundary_terms": [b.key for b in problem.blocks if b.transient],
        "excess_torque": {
            b.key: [float(np.sqrt(e[:, i].mean())) for i in range(motors)]
            for b, e in zip(problem.blocks, excess, strict=True)
            if e.any()
        },
    }
