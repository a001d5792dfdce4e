"""A start grown mass by mass: from rigid axes, each further mass where it takes most of what is missed.

Rigid axes have one minimum, and a mass cut in two by a stiff spring begins where the whole one ended: the
cost only falls, and no resonance has to be read from an FRF. That is for records that show few of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from invid.likelihood.fit import NOISE_SHARES, tempered
from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.nuisance.torque_lags import add_coulomb_columns
from invid.likelihood.records import problem_from_spectra, transfer_parameters
from invid.likelihood.residual import MissingTorqueProblem
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.signals.spectra import LineSpectra

SHARES = (0.2, 0.5, 0.8)
"""Shares of a mass beyond a new spring that are tried (empirical)."""
FREQUENCIES, REACH = 8, 4.0
"""Frequencies of a new spring that are tried, and the highest over the highest excited one (empirical)."""
FITTED = 2
"""New springs of a mass that are fitted, of those that a scan puts first (empirical)."""
ITERATIONS = 15
"""Iterations of such a fit (empirical)."""
DAMPING = 0.02
"""Damping ratio of a new spring (empirical)."""


class _Grown(NamedTuple):
    """Chains of one size with their fit, and the share of every amplitude that counted as noise in it."""

    problem: MissingTorqueProblem
    solution: Solution
    share: float

    @property
    def chains(self) -> CoupledChains:
        structure = self.problem.structure
        return structure.chains(self.solution.p[: structure.count])


def grow_chains(
    spectra: Sequence[LineSpectra], sizes: Sequence[int], axes: Sequence[str]
) -> CoupledChains | None:
    """Chains of ``sizes`` grown from rigid axes; ``None`` where the records are too few or time is spent.

    A chain that is too short misses by shares, on every line. So a share of every amplitude counts as noise,
    a smaller one as soon as the chain misses less.
    """
    first, *smaller = NOISE_SHARES
    problem = _problem((1,) * len(sizes), axes, spectra, first)
    if problem.dof <= 0:
        return None
    start = problem.start(problem.structure.vector(_rigid_axes(problem)))
    grown = _Grown(problem, gauss_newton(problem, start, iterations=2 * ITERATIONS, tolerance=0.1), first)
    omega = np.concatenate([b.omega[b.omega > 0] for b in problem.blocks])
    new_springs = np.geomspace(omega.min(), REACH * omega.max(), FREQUENCIES)
    while grown.problem.structure.sizes != tuple(sizes):
        if budget.is_spent():
            return None
        while grown.solution.reduced < 1.0 and smaller:
            share = smaller.pop(0)
            problem = _problem(grown.problem.structure.sizes, axes, spectra, share)
            again = gauss_newton(problem, grown.solution.p, iterations=ITERATIONS, tolerance=0.1)
            grown = _Grown(problem, again, share)
        larger = _with_one_mass_more(grown, sizes, spectra, new_springs)
        if larger is None:
            return None
        grown = larger
    return grown.chains


def _problem(
    sizes: tuple[int, ...], axes: Sequence[str], spectra: Sequence[LineSpectra], share: float
) -> MissingTorqueProblem:
    """The fit of chains of these sizes with a share of every amplitude as noise."""
    problem = problem_from_spectra(ChainStructure(sizes, tuple(axes)), spectra)
    return tempered(add_coulomb_columns(problem, spectra), share)


def _rigid_axes(problem: MissingTorqueProblem) -> CoupledChains:
    """Masses by which each axis' torque follows its own acceleration."""
    masses = []
    for i in range(problem.structure.motors):
        acceleration = np.concatenate([b.omega**2 * np.abs(b.position[:, i]) for b in problem.blocks])
        torque = np.concatenate([np.abs(b.torque[:, i]) for b in problem.blocks])
        masses.append([float(acceleration @ torque / max(acceleration @ acceleration, 1e-300))])
    none: list[list[float]] = [[] for _ in masses]
    return CoupledChains.build(masses, none, none, np.zeros((len(masses),) * 2), axes=problem.structure.axes)


def _with_one_mass_more(
    grown: _Grown, sizes: Sequence[int], spectra: Sequence[LineSpectra], new_springs: Float64
) -> _Grown | None:
    """The best fit with one mass more on an axis that is short of one; ``None`` where none is finite."""
    have, here = grown.problem.structure.sizes, grown.chains
    best: _Grown | None = None
    for i in (i for i, n in enumerate(have) if n < sizes[i]):
        problem = _problem(tuple(n + (k == i) for k, n in enumerate(have)), here.axes, spectra, grown.share)
        start = transfer_parameters(grown.problem, grown.solution.p, problem)
        beside = start[problem.structure.count :]
        for k in range(have[i]):
            cut = _cut_in_two(here, i, k, new_springs)
            starts = [np.append(problem.structure.vector(c), beside) for c in cut]
            for p in sorted(starts, key=lambda p: _cost(problem, p))[:FITTED]:
                try:
                    found = gauss_newton(problem, p, iterations=ITERATIONS, tolerance=0.1)
                except np.linalg.LinAlgError:
                    continue
                if best is None or found.chi2 < best.solution.chi2:
                    best = _Grown(problem, found, grown.share)
    return best


def _cut_in_two(chains: CoupledChains, axis: int, mass: int, frequencies: Float64) -> Iterator[CoupledChains]:
    """The chains with one mass cut in two, for every share of ``SHARES`` and frequency of the new spring."""
    whole = float(chains.masses[axis][mass])
    is_end = mass == chains.masses[axis].size - 1
    least = _least_end_mass(chains, axis) if is_end else 0.0
    for share in SHARES:
        far = least + share * (whole - least)
        between = (whole - far) * far / whole
        for omega in frequencies:
            stiffness = between * float(omega) ** 2
            masses, springs, dampers = (
                [branch.tolist() for branch in each]
                for each in (chains.masses, chains.springs, chains.dampers)
            )
            masses[axis][mass : mass + 1] = [whole - far, far]
            springs[axis].insert(mass, stiffness)
            dampers[axis].insert(mass, 2.0 * DAMPING * float(np.sqrt(stiffness * between)))
            yield CoupledChains.build(masses, springs, dampers, chains.couplings, axes=chains.axes)


def _least_end_mass(chains: CoupledChains, axis: int) -> float:
    """What a final mass has to be for the inertias coupled to it to be those of bodies."""
    ends = chains.couplings + np.diag([m[-1] for m in chains.masses])
    others = [k for k in range(ends.shape[0]) if k != axis]
    if not others:
        return 0.0
    return float(ends[axis, others] @ np.linalg.solve(ends[np.ix_(others, others)], ends[others, axis]))


def _cost(problem: MissingTorqueProblem, p: Float64) -> float:
    """χ², infinite where it is none."""
    if not problem.structure.admissible(p[: problem.structure.count]):
        return np.inf
    with np.errstate(all="ignore"):
        try:
            residual = problem.residual_of(p, problem.states(p))
        except np.linalg.LinAlgError:
            return np.inf
    cost = float(residual @ residual)
    return cost if np.isfinite(cost) else np.inf


__all__ = ["grow_chains"]
