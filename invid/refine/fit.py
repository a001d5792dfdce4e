"""The whole fit of one structure: starts, nuisances, weights, covariance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invid.arrays import Complex128, Float64
from invid.chains import CoupledChains
from invid.distributions import chi2_isf
from invid.errors import NotIdentifiableError
from invid.refine.blocks import (
    carried,
    driven_and_held,
    hold_laws,
    hold_offset,
    problem_from_spectra,
    used_lines,
    with_columns,
)
from invid.refine.friction import coulomb_columns
from invid.refine.problem import MissingTorqueProblem
from invid.refine.solver import Solution, gauss_newton, spectrum_of
from invid.refine.structure import ChainStructure
from invid.refine.weights import excess_variance
from invid.spectra import LineSpectra

NEEDED = 1e-3
"""Significance at which boundary terms are added: wrong once in a thousand settled records."""
COULOMB_SIGMA = 4.0
"""Standard deviations (excess variance included) below which Coulomb friction leaves the fit."""


COULOMB = ".coulomb"
HOLD_LAG = ".hold_lag"
"""Endings of the names of columns: Coulomb friction, and a hold inside the drive acting later."""
REVERSAL = ".reversal_lag"
"""Ending of the names of the columns by which Coulomb friction may turn later than the velocity."""
TEMPER = (0.1, 0.03, 0.01, 0.003)
"""Shares of every amplitude that count as noise while a start is led to its minimum: under the sensors'
noise alone the valley is so narrow that a start 12 % off in one spring of a chain of five ends in
another minimum; a tenth of the amplitude makes it wide, and each step starts within the next."""


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
    starts: Iterable[CoupledChains],
    *,
    thorough: bool = True,
) -> Fit:
    """Maximum-likelihood fit of ``structure`` from the best of several starts.

    ``thorough=False`` stops after the first pass (for comparing structures).
    """
    problem = with_coulomb(problem_from_spectra(structure, spectra), spectra)
    if problem.dof <= 0:
        rows = sum(2 * b.position.size for b in problem.blocks)
        raise NotIdentifiableError(
            f"{sum(b.omega.size for b in problem.blocks)} lines give {rows} equations for "
            f"{rows - problem.dof} unknowns: lengthen the period, widen the band, or use fewer masses"
        )
    solution = _best(problem, starts, 80 if thorough else 30)
    holds: dict[str, str] = {}
    if thorough:
        problem, solution = _boundary(problem, solution, spectra)
        problem, solution, holds = _holds(problem, solution, spectra)
        problem, solution = _inner_friction(problem, solution)
    base = [b.covariance for b in problem.blocks]
    noise_chi2, noise_cost = solution.reduced, solution.chi2
    excess: list[Float64] = []
    if thorough:
        problem, solution, excess = _weighted(problem, solution, base)
        plain = problem.with_covariance(base)
        again = gauss_newton(plain, solution.p)
        if again.chi2 < 0.9 * noise_cost:
            # The weights led out of a wrong minimum: what is left beyond the noise is to be judged anew.
            noise_chi2, noise_cost = again.reduced, again.chi2
            problem, solution, excess = _weighted(plain, again, base)
        problem, solution, excess = _drop_coulomb(problem, solution, base, excess)
        problem, solution = _reversal_lag(problem, solution)
    free = physical_covariance(problem, solution)
    problem, solution = _physical(problem, solution)
    covariance = physical_covariance(problem, solution)
    # A damper held at zero keeps the standard deviation it had when free.
    pinned = np.flatnonzero(~solution.free[: problem.structure.count])
    covariance[pinned, pinned] = np.diag(free)[pinned]
    explained = _explained(problem, solution)
    return Fit(
        problem,
        solution,
        problem.structure,
        problem.structure.chains(solution.p[: problem.structure.count]),
        covariance,
        noise_chi2,
        noise_cost,
        explained,
        {**_facts(problem, solution, excess), "holds": holds},
    )


def physical_covariance(problem: MissingTorqueProblem, solution: Solution) -> Float64:
    """(n, n) covariance of the structure's parameters in physical units, inflated by χ²/ν > 1.

    Directions that the data do not see (singular values below 1e-9 of the largest, columns scaled)
    get an infinite variance on every parameter they move by more than a hundredth.
    """
    full = np.zeros((solution.p.size, solution.p.size))
    free = np.flatnonzero(solution.free)
    scale, size, right, blind = spectrum_of(solution.jacobian)
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


def spread_of(solution: Solution) -> Float64:
    """(n,) standard deviation of every parameter as it moves (logarithms relative), inflated; NaN where
    fixed, infinite where the data do not see it."""
    scale, size, right, blind = spectrum_of(solution.jacobian)
    size = np.maximum(size, 1e-9 * size[0])
    own = np.sqrt(((right / size[:, None]) ** 2).sum(axis=0)) / scale
    own[blind] = np.inf
    out = np.full(solution.p.size, np.nan)
    out[solution.free] = own * np.sqrt(max(1.0, solution.reduced))
    return out


def with_coulomb(problem: MissingTorqueProblem, spectra: Sequence[LineSpectra]) -> MissingTorqueProblem:
    """One Coulomb coefficient for each axis that moves clearly in some record, and one lag for each hold
    that works beside a command inside the drive."""
    motors = problem.structure.motors
    found = [coulomb_columns(s) for s in spectra]
    axes = [i for i in range(motors) if any(bool(moves[i]) for _, moves in found)]
    held = [
        i
        for i in range(motors)
        if any(s.hold_torque is not None and bool(np.any(s.hold_torque[:, i])) for s in spectra)
    ]
    columns = []
    for (spectrum, moves), s, block in zip(found, spectra, problem.blocks, strict=True):
        used = used_lines(s, everything=block.transient)
        part = np.zeros((int(used.sum()), motors, len(axes) + len(held)), dtype=complex)
        for at, i in enumerate(axes):
            if moves[i]:
                part[:, i, at] = spectrum[used, i]
        for at, i in enumerate(held, start=len(axes)):
            if s.hold_torque is not None:
                part[:, i, at] = 1j * s.omega[used] * s.hold_torque[used, i]
        columns.append(part)
    names = problem.structure.axes
    lags = [f"{names[i]}{HOLD_LAG}" for i in held]
    step = max(b.step for b in problem.blocks)
    # A drive's own loop runs several times a sample; the torque it asks for acts within one such cycle.
    known = dict.fromkeys(lags, (0.0, step / 8.0))
    problem = replace(problem, priors={**problem.priors, **known})
    return with_columns(problem, columns, [f"{names[i]}{COULOMB}" for i in axes] + lags)


def _best(problem: MissingTorqueProblem, starts: Iterable[CoupledChains], iterations: int) -> Solution:
    """The lowest cost from all starts; stops at the first that cannot be told from noise, or where a
    second start leads to the same minimum as the best before it."""
    best: Solution | None = None
    for start in starts:
        p = problem.start(problem.structure.vector(start))
        for share in TEMPER:
            p = gauss_newton(_tempered(problem, share), p, iterations=15, tolerance=0.1).p
        found = gauss_newton(problem, p, iterations=iterations)
        again = best is not None and abs(found.chi2 - best.chi2) < 1e-3 * best.chi2
        if best is None or found.chi2 < best.chi2:
            best = found
        if again or best.reduced < 1.5:
            break
    if best is None:
        raise NotIdentifiableError(
            "no start for the fit: no frequency at which all axes are excited; excite every axis, one an "
            "experiment or all at once"
        )
    return best


def _tempered(problem: MissingTorqueProblem, share: float) -> MissingTorqueProblem:
    """The problem with a share of every amplitude as further noise."""
    covariances = []
    for block in problem.blocks:
        covariance = block.covariance.copy()
        index = np.arange(2 * problem.structure.motors)
        power = np.abs(np.concatenate((block.position, block.torque), axis=1)) ** 2
        covariance[:, index, index] += share**2 * power
        covariances.append(covariance)
    return problem.with_covariance(covariances)


def _holds(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution, dict[str, str]]:
    """What the holds do while their axis is driven, where no recorded demand tells.

    Two cells give the same data: (a) hold and command are held over the sample alike; (b) the hold
    runs inside the drive, continuous, beside a command held over the sample, and then acts half a
    sample earlier. With hold gains P, D they differ by a viscous friction P·h/2 and a motor inertia
    D·h/2, exactly (less where the drive's loop is slow). Friction tells them apart: where it is zero
    with (a), or on all axes with one common earliness, that is taken; where neither, the half sample
    stays open and its effect goes into the covariance.
    """
    structure = problem.structure
    names = [hold_offset(structure.axes[i]) for i in driven_and_held(spectra)]
    laws = hold_laws(spectra, driven_and_held(spectra))
    step = 1.0 / spectra[0].sample_rate_hz
    spread = spread_of(solution)
    at = {name: k for k, name in enumerate(problem.names)}
    open_axes, decided = [], {}
    for i, name in zip(driven_and_held(spectra), names, strict=True):
        if i not in laws or any(s.staircase[i] == 1.0 for s in spectra):
            continue
        offset, error = solution.p[at[name]], spread[at[name]]
        if abs(offset) > max(4.0 * error, 0.1 * step):
            decided[structure.axes[i]] = "hold and command act at different times; no hold while driven"
            continue
        open_axes.append(i)
    if not open_axes:
        return problem, solution, decided
    motors = np.array(open_axes)
    viscous = np.array([solution.p[structure.slices["viscous"].start + i] for i in motors])
    error = np.array([spread[structure.slices["viscous"].start + i] for i in motors])
    shift = np.array([laws[i][0] * step / 2 for i in motors])
    if np.all(shift < error):
        return problem, solution, decided
    early = 2.0 / step * shift  # viscous friction a second of earliness looks like
    without = float(np.sum((viscous / error) ** 2))
    common = float(np.sum(viscous * early / error**2) / np.sum((early / error) ** 2))
    common_error = float(1.0 / np.sqrt(np.sum((early / error) ** 2)))
    within = float(np.sum(((viscous - early * common) / error) ** 2))
    # 3 standard deviations' worth of false rejection; one degree of freedom goes into the common time.
    limit = chi2_isf(0.0027, motors.size)
    tight = chi2_isf(0.0027, motors.size - 1) if motors.size > 1 else 0.0
    fixed = [hold_offset(structure.axes[i]) for i in open_axes]
    if without < limit:
        priors = {**problem.priors, **dict.fromkeys(fixed, (0.0, 1e-3 * step))}
        text = "as the command, held over the sample"
        freed = replace(problem, priors=priors)
    else:
        holds = {i: laws[i] for i in open_axes}
        blocks = problem_from_spectra(
            structure, spectra, boundary=[b.transient for b in problem.blocks], holds=holds
        ).blocks
        blocks = tuple(
            replace(new, columns=old.columns, covariance=old.covariance)
            for new, old in zip(blocks, problem.blocks, strict=True)
        )
        if within < tight and 0.0 < common < 0.55 * step:
            prior, text = (-common, common_error), f"inside the drive, {common:.3g} s before the command"
        else:
            prior, text = (-step / 4, step / 4), "open: inside the drive or held over the sample"
        freed = replace(problem, blocks=blocks, priors={**problem.priors, **dict.fromkeys(fixed, prior)})
    decided |= {structure.axes[i]: text for i in open_axes}
    start = solution.p.copy()
    for name in fixed:
        start[at[name]] = freed.priors[name][0]
    return freed, gauss_newton(freed, start), decided


def _boundary(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution]:
    """Boundary terms for periodic records whose transient has not died: where they pay for themselves."""
    flags = [b.transient for b in problem.blocks]
    count = 2 * problem.structure.dofs
    for number, block in enumerate(problem.blocks):
        rows = 2 * block.position.size
        if block.transient or rows < 3 * count:
            continue
        alone = replace(problem, blocks=(block,))
        freed = replace(problem, blocks=(replace(block, transient=True),))
        plain, _ = alone.evaluate(solution.p)
        with_terms, _ = freed.evaluate(solution.p)
        before, after = float(plain[:rows] @ plain[:rows]), float(with_terms[:rows] @ with_terms[:rows])
        # The scale is what is left with the terms in: friction that is left must not look like one.
        gain = (before - after) / max(after / (rows - count), 1.0)
        flags[number] = bool(gain > chi2_isf(NEEDED, count))
    if flags == [b.transient for b in problem.blocks]:
        return problem, solution
    freed = with_coulomb(problem_from_spectra(problem.structure, spectra, boundary=flags), spectra)
    return freed, gauss_newton(freed, carried(problem, solution.p, freed))


def _inner_friction(
    problem: MissingTorqueProblem, solution: Solution
) -> tuple[MissingTorqueProblem, Solution]:
    """Viscous friction of the masses beyond the motor, where the data ask for it.

    A bearing at the load shifts the antiresonance that the load's mass is read from.
    """
    structure = problem.structure
    if structure.inner_viscous or not structure.inner_dofs:
        return problem, solution
    larger = replace(problem, structure=replace(structure, inner_viscous=True))
    found = gauss_newton(larger, carried(problem, solution.p, larger))
    extra = len(structure.inner_dofs)
    scale = max(found.reduced, 1.0)
    part = slice(structure.slices["viscous"].stop, structure.slices["viscous"].stop + extra)
    positive = found.p[part] > -3.0 * spread_of(found)[part]
    if (solution.chi2 - found.chi2) / scale > chi2_isf(NEEDED, extra) and positive.all():
        return larger, found
    return problem, solution


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
        if np.all(moved < 0.1 * spread_of(solution)[solution.free]):
            break
    return problem, solution, excess


def _drop_coulomb(
    problem: MissingTorqueProblem, solution: Solution, base: list[Complex128], excess: list[Float64]
) -> tuple[MissingTorqueProblem, Solution, list[Float64]]:
    """Leaves out Coulomb coefficients that the data do not ask for, or that would drive the motion."""
    part = problem.slices["column"]
    if part.start == part.stop:
        return problem, solution, excess
    keep = solution.p[part] > COULOMB_SIGMA * spread_of(solution)[part]
    keep = keep | np.array([not n.endswith(COULOMB) for n in problem.column_names])
    if keep.all():
        return problem, solution, excess
    names = tuple(n for n, k in zip(problem.column_names, keep, strict=True) if k)
    reduced = with_columns(problem, [b.columns[:, :, keep] for b in problem.blocks], names)
    solution = gauss_newton(reduced, carried(problem, solution.p, reduced))
    return _weighted(reduced, solution, base)


def _reversal_lag(problem: MissingTorqueProblem, solution: Solution) -> tuple[MissingTorqueProblem, Solution]:
    """When Coulomb friction turns round is known to half a sample, no better; the data may say more.

    A motor that reverses stands for a moment, and the sign of its velocity does not tell when its
    friction turned. Friction that turns later looks like motor inertia: with the instant taken as
    known, the motor's mass was off by three to five of its standard deviations (virtual cells).
    """
    names = problem.column_names
    rubbing = [k for k, n in enumerate(names) if n.endswith(COULOMB)]
    if not rubbing:
        return problem, solution
    size = np.abs(solution.p[problem.slices["column"]][rubbing])
    columns = []
    for block in problem.blocks:
        turned = -1j * block.omega[:, None, None] * block.columns[:, :, rubbing]
        columns.append(np.concatenate((block.columns, turned), axis=2))
    lags = tuple(names[k].removesuffix(COULOMB) + REVERSAL for k in rubbing)
    step = max(b.step for b in problem.blocks)
    # Even within half a sample either way: a standard deviation of h/√12.
    known = {n: (0.0, float(c) * step / np.sqrt(12.0)) for n, c in zip(lags, size, strict=True) if c > 0}
    larger = replace(
        with_columns(problem, columns, names + lags),
        priors={**problem.priors, **known},
        fixed=(*problem.fixed, *(n for n in lags if n not in known)),
    )
    return larger, gauss_newton(larger, carried(problem, solution.p, larger))


def _physical(problem: MissingTorqueProblem, solution: Solution) -> tuple[MissingTorqueProblem, Solution]:
    """Dampers and viscous friction that came out negative are held at zero, and the rest fitted again.

    A viscous friction that is negative by more than three standard deviations stays: something else
    wears its mask, and hiding that would bias the rest.
    """
    structure = problem.structure
    dampers, viscous = structure.slices["damper"], structure.slices["viscous"]
    for _ in range(3):
        spread = spread_of(solution)
        pinned = [
            k
            for k in (*range(dampers.start, dampers.stop), *range(viscous.start, viscous.stop))
            if solution.free[k]
            and solution.p[k] < 0
            and (k < dampers.stop or solution.p[k] > -3.0 * spread[k])
        ]
        if not pinned:
            break
        problem = replace(problem, fixed=(*problem.fixed, *(problem.names[k] for k in pinned)))
        start = solution.p.copy()
        start[pinned] = 0.0
        solution = gauss_newton(problem, start)
    return problem, solution


def _explained(problem: MissingTorqueProblem, solution: Solution) -> float:
    """Share of the (noise-weighted) torque power that the model accounts for, 0 … 1."""
    left = total = 0.0
    for state in problem.states(solution.p):
        weight = 1.0 / np.maximum(np.einsum("fii->fi", state.covariance).real, 1e-300)
        left += float((np.abs(state.residual) ** 2 * weight).sum())
        total += float((np.abs(state.block.torque) ** 2 * weight).sum())
    return max(0.0, 1.0 - left / max(total, 1e-300))


def _facts(problem: MissingTorqueProblem, solution: Solution, excess: list[Float64]) -> dict[str, Any]:
    spread = spread_of(solution)
    s = problem.slices

    def listed(part: slice) -> dict[str, dict[str, float]]:
        return {
            problem.names[k]: {"value": float(solution.p[k]), "std": float(spread[k])}
            for k in range(part.start, part.stop)
            if solution.free[k]
        }

    viscous = problem.structure.slices["viscous"]
    motors = problem.structure.motors
    friction = {k: v for k, v in listed(s["column"]).items() if k.endswith(COULOMB)}
    return {
        "result": solution.result,
        "iterations": solution.iterations,
        "chi2": solution.chi2,
        "dof": solution.dof,
        "time_offset_s": listed(s["delay"]),
        "held_over_sample": listed(s["staircase"]),
        "friction": {**friction, **listed(viscous)},
        "boundary_terms": [b.key for b in problem.blocks if b.transient],
        "excess_torque": {
            b.key: [float(np.sqrt(e[:, i].mean())) for i in range(motors)]
            for b, e in zip(problem.blocks, excess, strict=False)
            if e.any()
        },
    }
