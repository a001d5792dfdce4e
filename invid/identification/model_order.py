"""Choice of the number of masses of each branch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from invid.errors import InvidError
from invid.identification.further_mode import MissingMode, chains_with_mode, missing_mode
from invid.identification.starts import fit_sizes, measured_frf
from invid.likelihood.fit import AT_NOISE, Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.numerics.distributions import chi2_isf
from invid.signals.spectra import LineSpectra


@dataclass(frozen=True)
class OrderChoice:
    """The masses of each branch and the evidence."""

    sizes: tuple[int, ...]
    evidence: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    chains: CoupledChains | None = None
    """The plant found with those masses: a start."""


GAIN = 1.3
"""Factor by which a further mass must lower χ². Empirical: coloured residuals (friction, ripple) let any
extra parameter fit a few per cent of them, a missing mode leaves tens to thousands (case study: 26 000 for
two masses, 1.3 for three and for four)."""
NEAR_NOISE = 3.0
"""χ²/ν up to which the gain of one mode more is estimated from the missing torque alone; beyond, the fit may
be in a wrong minimum. Empirical: unmodelled friction leaves 1.1 to 3 in records without a period."""
MOST_RELATIVE_STD = 0.5
"""Relative standard deviation of a final mass from which it counts as none (statistical): the data tell it
neither from a wall nor (two of them below it) from nothing."""


def choose_order(spectra: Sequence[LineSpectra], axes: Sequence[str], *, most: int = 6) -> OrderChoice:
    """The fewest masses that explain the data.

    Equal numbers for all branches grow until χ² falls no further; then masses are taken away branch
    by branch while it does not rise.
    """
    count = len(axes)
    measured = measured_frf(spectra)
    costs: dict[tuple[int, ...], float] = {}
    dofs: dict[tuple[int, ...], int] = {}
    chains: dict[tuple[int, ...], CoupledChains] = {}
    fits: dict[tuple[int, ...], Fit] = {}
    modes: dict[tuple[int, ...], MissingMode | None] = {}
    vanishing_by_sizes: dict[str, list[str]] = {}
    fixed_by_sizes: dict[str, list[str]] = {}

    def cost(sizes: tuple[int, ...], parent: tuple[int, ...] = ()) -> float:
        if sizes not in costs:
            split_start = _split_final_masses(chains.get(parent), sizes)
            smaller = (sizes[0] - 1,)
            hidden = (
                _fit_with_hidden_mode(spectra, fits.get(smaller), mode_of(smaller)) if count == 1 else None
            )
            try:
                if hidden is not None and hidden.noise_chi2 < AT_NOISE:
                    fit = hidden
                else:
                    fit = fit_sizes(spectra, sizes, axes, measured, thorough=False, further=split_start)
                    fit = hidden if hidden is not None and hidden.noise_cost < fit.noise_cost else fit
            except (InvidError, np.linalg.LinAlgError):
                costs[sizes], dofs[sizes] = np.inf, 1
            else:
                costs[sizes], dofs[sizes] = fit.noise_cost, max(fit.problem.dof, 1)
                chains[sizes] = fit.chains
                fits[sizes] = fit
                vanished = _vanishing_masses(fit)
                if vanished:
                    vanishing_by_sizes[_label(sizes)] = vanished
                fixed = _fixed_masses(fit)
                if fixed:
                    fixed_by_sizes[_label(sizes)] = fixed
        return costs[sizes]

    def mode_of(sizes: tuple[int, ...]) -> MissingMode | None:
        if sizes not in modes:
            modes[sizes] = missing_mode(fits[sizes]) if sizes in fits else None
        return modes[sizes]

    def is_settled(small: tuple[int, ...]) -> bool:
        """Whether no further mass could be better by the factor asked for."""
        before = cost(small)
        if count > 1 or small == (1,):
            return before < GAIN * dofs[small]  # already noise
        # Not by the noise: a floor that is too high hides a mode. What one mode takes to first order, twice.
        mode = mode_of(small) if before < NEAR_NOISE * dofs[small] else None
        gain = np.inf if before >= NEAR_NOISE * dofs[small] else 0.0 if mode is None else mode.gain
        return bool(2.0 * gain < (1.0 - 1.0 / GAIN) * before)

    def is_needed(small: tuple[int, ...], large: tuple[int, ...]) -> bool:
        """Whether the larger structure is better by more than its parameters may."""
        before = cost(small)
        if is_settled(small):
            return False
        if large not in costs and budget.is_left_out(f"{_label(large)} masses"):
            return False
        budget.tell(f"trying {_label(large)} masses", 0.3 * (1.0 - 0.8 ** len(costs)))
        after = cost(large, small)
        if not np.isfinite(after) or _label(large) in vanishing_by_sizes or _label(large) in fixed_by_sizes:
            return False  # a mass that goes to nothing, or stands still, is none: it fits something else
        if not np.isfinite(before):
            return True
        extra = 3 * (sum(large) - sum(small))
        scale = max(after / dofs[large], 1.0)
        significant = (before - after) / scale > chi2_isf(1e-6, extra)
        return bool(significant and before > GAIN * after)

    best = (1,) * count
    while best[0] < most:
        n = best[0] + 1
        following = (n,) * count
        if is_needed(best, following):
            best = following
            continue
        # One order alone may not pay where two do (a pair of modes close together).
        if n < most and is_needed(best, (n + 1,) * count):
            best = (n + 1,) * count
            continue
        break
    if count > 1 and not budget.is_left_out("masses more or less on single axes"):
        best = _remove_masses(_add_masses(best, is_needed, cost, most), is_needed, cost)
    alike = _equivalent_structures(best, costs, dofs)
    # Of those that the data cannot tell apart the most even one stands first.
    best, *alike = sorted((best, *alike), key=lambda n: (max(n) - min(n), n != best, costs[n]))
    warnings = []
    if count > 1 and not alike and max(best) > 1:
        warnings.append(
            f"order: {_label(best)} masses are the fewest that explain the data; where the ends of branches "
            "are coupled, motors cannot always tell on which branch a mass hangs: say the numbers if known "
            "(--masses)"
        )
    if max(best) == most:
        warnings.append(
            f"order: {most} masses a branch are the most that are tried, and the data ask for them"
        )
    evidence = {
        "chosen": list(best),
        "alike": [list(sizes) for sizes in alike],
        "chi2_per_dof": {
            _label(sizes): (value / dofs[sizes] if np.isfinite(value) else None)
            for sizes, value in costs.items()
        },
        "vanishing": vanishing_by_sizes,
        "standing": fixed_by_sizes,
    }
    return OrderChoice(best, evidence, warnings, chains.get(best))


def _fit_with_hidden_mode(
    spectra: Sequence[LineSpectra], smaller: Fit | None, mode: MissingMode | None
) -> Fit | None:
    """The fit with one mass more, started from the mode that the smaller one lacks.

    Separate from the other starts: where it falls back to the smaller chain, as a split mass may, the two
    would count as one minimum found twice, and no further start be tried.
    """
    if smaller is None or mode is None:
        return None
    try:
        starts = chains_with_mode(smaller.chains, mode)
        structure = ChainStructure((smaller.structure.sizes[0] + 1,), smaller.structure.axes)
        found = fit_structure(spectra, structure, starts, thorough=False) if starts else None
    except (InvidError, np.linalg.LinAlgError):
        return None
    return None if found is None or _vanishing_masses(found) or _fixed_masses(found) else found


def _remove_masses(
    best: tuple[int, ...],
    is_needed: Callable[[tuple[int, ...], tuple[int, ...]], bool],
    cost: Callable[[tuple[int, ...]], float],
) -> tuple[int, ...]:
    """Sizes with masses removed, cheapest first, as long as one is not needed."""
    while not budget.is_left_out("masses less on single axes"):
        smaller = [(*best[:i], n - 1, *best[i + 1 :]) for i, n in enumerate(best) if n > 1]
        removable = [s for s in smaller if np.isfinite(cost(s)) and not is_needed(s, best)]
        if not removable:
            return best
        best = min(removable, key=cost)
    return best


def _add_masses(
    best: tuple[int, ...],
    is_needed: Callable[[tuple[int, ...], tuple[int, ...]], bool],
    cost: Callable[[tuple[int, ...]], float],
    most: int,
) -> tuple[int, ...]:
    """Sizes with masses added to single branches as long as one is needed."""
    while True:
        larger = [(*best[:i], n + 1, *best[i + 1 :]) for i, n in enumerate(best) if n < most]
        better = [s for s in larger if is_needed(best, s)]
        if not better:
            return best
        best = min(better, key=cost)


def _equivalent_structures(
    best: tuple[int, ...], costs: dict[tuple[int, ...], float], dofs: dict[tuple[int, ...], int]
) -> list[tuple[int, ...]]:
    """Other structures with as many masses that the data cannot tell from the best.

    Between two branches with coupled ends a mass may belong to the one or the other with the same motion of
    every motor, as long as all values stay positive.
    """
    scale = max(costs[best] / dofs[best], 1.0)
    # As good as the best up to what one parameter may gain by chance once in a thousand.
    limit = costs[best] + chi2_isf(1e-3, 1) * scale
    return [s for s, value in costs.items() if s != best and sum(s) == sum(best) and value < limit]


def _split_final_masses(chains: CoupledChains | None, sizes: tuple[int, ...]) -> list[CoupledChains]:
    """The smaller model with its final masses split by stiff springs: a start of equal cost."""
    if chains is None or any(n < m for n, m in zip(sizes, chains.masses_per_branch, strict=True)):
        return []
    masses, springs, dampers = [], [], []
    for m, k, d, n in zip(chains.masses, chains.springs, chains.dampers, sizes, strict=True):
        further = n - m.size
        # The motor's own mass is halved: the final mass must stay beside its couplings.
        head = np.full(further + 1, m[0] / (further + 1))
        stiff = 30.0 * (k.max() if k.size else m.sum() * 1e4)
        if m.size == 1 and further:
            head = m[0] * np.append(np.full(further, 0.1 / further), 0.9)
        masses.append(np.concatenate((head, m[1:])))
        springs.append(np.concatenate((np.full(further, stiff), k)))
        dampers.append(np.concatenate((np.full(further, d.max(initial=0.0)), d)))
    try:
        return [CoupledChains.build(masses, springs, dampers, chains.couplings, axes=chains.axes)]
    except InvidError:
        return []


def _vanishing_masses(fit: Fit) -> list[str]:
    """Names of masses below a thousandth of their branch: the sign of one too many."""
    out = []
    for axis, m in zip(fit.chains.axes, fit.chains.masses, strict=True):
        out += [f"{axis}.mass.{q + 1}" for q in np.flatnonzero(m < 1e-3 * m.sum())]
    return out


def _fixed_masses(fit: Fit) -> list[str]:
    """Names of final masses that the data do not tell from a wall, as a soft spring to ground looks like
    one."""
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    masses, out, last = fit.structure.slices["mass"].start, [], -1
    for axis, m in zip(fit.chains.axes, fit.chains.masses, strict=True):
        last += m.size
        if m.size > 1 and not std[masses + last] < MOST_RELATIVE_STD * m[-1]:
            out.append(f"{axis}.mass.{m.size}")
    return out


def _label(sizes: tuple[int, ...]) -> str:
    return ",".join(str(n) for n in sizes)
