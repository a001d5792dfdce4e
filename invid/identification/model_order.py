"""Choice of the number of masses of each branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
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


CUT_SHORT = "cut_short"
"""Name of the evidence that the budget ended the choice: orders that were not tried are not refuted."""
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


Sizes = tuple[int, ...]
"""Masses of each branch."""


@dataclass(frozen=True, eq=False)
class OrderTrial:
    """One structure fitted to the records; ``fit`` is ``None`` where none was possible, at infinite cost."""

    cost: float
    dof: int
    fit: Fit | None = None

    @cached_property
    def vanishing(self) -> list[str]:
        """Masses that go to nothing."""
        return [] if self.fit is None else _vanishing_masses(self.fit)

    @cached_property
    def standing(self) -> list[str]:
        """Final masses that the data do not tell from a wall."""
        return [] if self.fit is None else _fixed_masses(self.fit)


class OrderSearch:
    """Structures of increasing order, each fitted once."""

    def __init__(self, spectra: Sequence[LineSpectra], axes: Sequence[str], most: int) -> None:
        self.spectra, self.axes, self.most = spectra, axes, most
        self.measured = measured_frf(spectra)
        self.trials: dict[Sizes, OrderTrial] = {}
        self._modes: dict[Sizes, MissingMode | None] = {}

    def trial(self, sizes: Sizes, parent: Sizes = ()) -> OrderTrial:
        """The structure fitted, from its own starts and from ``parent`` with its final masses split."""
        if sizes not in self.trials:
            try:
                fit = self._fitted(sizes, parent)
            except (InvidError, np.linalg.LinAlgError):
                self.trials[sizes] = OrderTrial(np.inf, 1)
            else:
                self.trials[sizes] = OrderTrial(fit.noise_cost, max(fit.problem.dof, 1), fit)
        return self.trials[sizes]

    def _fitted(self, sizes: Sizes, parent: Sizes) -> Fit:
        known = self.trials.get(parent)
        split = _split_final_masses(None if known is None or known.fit is None else known.fit.chains, sizes)
        hidden = None
        if len(sizes) == 1:
            smaller = (sizes[0] - 1,)
            before = self.trials.get(smaller)
            hidden = _fit_with_hidden_mode(
                self.spectra, None if before is None else before.fit, self.mode_of(smaller)
            )
        if hidden is not None and hidden.noise_chi2 < AT_NOISE:
            return hidden
        fit = fit_sizes(self.spectra, sizes, self.axes, self.measured, thorough=False, further=split)
        return hidden if hidden is not None and hidden.noise_cost < fit.noise_cost else fit

    def cost(self, sizes: Sizes) -> float:
        """χ² of the structure against the sensors' noise."""
        return self.trial(sizes).cost

    def mode_of(self, sizes: Sizes) -> MissingMode | None:
        """The mode that the structure lacks, if one stands out of what it misses."""
        if sizes not in self._modes:
            known = self.trials.get(sizes)
            self._modes[sizes] = None if known is None or known.fit is None else missing_mode(known.fit)
        return self._modes[sizes]

    def is_settled(self, small: Sizes) -> bool:
        """Return whether no further mass could be better by the factor asked for."""
        before = self.trial(small)
        if len(small) > 1 or small == (1,):
            return before.cost < GAIN * before.dof  # already noise
        # Not by the noise: a floor that is too high hides a mode. What one mode takes to first order, twice.
        if before.cost >= NEAR_NOISE * before.dof:
            return False
        mode = self.mode_of(small)
        gain = 0.0 if mode is None else mode.gain
        return bool(2.0 * gain < (1.0 - 1.0 / GAIN) * before.cost)

    def is_needed(self, small: Sizes, large: Sizes) -> bool:
        """Return whether the larger structure is better by more than its parameters may."""
        before = self.trial(small)
        if self.is_settled(small):
            return False
        if large not in self.trials and budget.is_left_out(f"{_label(large)} masses"):
            return False
        budget.tell(f"trying {_label(large)} masses", 0.3 * (1.0 - 0.8 ** len(self.trials)))
        after = self.trial(large, small)
        if after.fit is None or after.vanishing or after.standing:
            return False  # a mass that goes to nothing, or stands still, is none: it fits something else
        if before.fit is None:
            return True
        extra = 3 * (sum(large) - sum(small))
        scale = max(after.cost / after.dof, 1.0)
        significant = (before.cost - after.cost) / scale > chi2_isf(1e-6, extra)
        return bool(significant and before.cost > GAIN * after.cost)

    def equal_sizes(self) -> Sizes:
        """Equal numbers for all branches, grown until χ² falls no further."""
        count = len(self.axes)
        best = (1,) * count
        while best[0] < self.most:
            # One order alone may not pay where two do (a pair of modes close together).
            following = [(n,) * count for n in (best[0] + 1, best[0] + 2) if n <= self.most]
            needed = next((sizes for sizes in following if self.is_needed(best, sizes)), None)
            if needed is None:
                break
            best = needed
        return best


def choose_order(spectra: Sequence[LineSpectra], axes: Sequence[str], *, most: int = 6) -> OrderChoice:
    """The fewest masses that explain the data.

    Equal numbers for all branches grow until χ² falls no further; then masses are taken away branch
    by branch while it does not rise.
    """
    search = OrderSearch(spectra, axes, most)
    best = search.equal_sizes()
    if len(axes) > 1 and not budget.is_left_out("masses more or less on single axes"):
        best = _remove_masses(_add_masses(best, search), search)
    alike = _equivalent_structures(best, search.trials)
    # Of those that the data cannot tell apart the most even one stands first.
    best, *alike = sorted((best, *alike), key=lambda n: (max(n) - min(n), n != best, search.cost(n)))
    warnings = []
    if len(axes) > 1 and not alike and max(best) > 1:
        warnings.append(
            f"order: {_label(best)} masses are the fewest that explain the data; where the ends of branches "
            "are coupled, motors cannot always tell on which branch a mass hangs: say the numbers if known "
            "(--masses)"
        )
    if max(best) == most:
        warnings.append(
            f"order: {most} masses a branch are the most that are tried, and the data ask for them"
        )
    trials = {_label(sizes): trial for sizes, trial in search.trials.items()}
    evidence = {
        "chosen": list(best),
        "alike": [list(sizes) for sizes in alike],
        "chi2_per_dof": {n: None if t.fit is None else t.cost / t.dof for n, t in trials.items()},
        "vanishing": {n: t.vanishing for n, t in trials.items() if t.vanishing},
        "standing": {n: t.standing for n, t in trials.items() if t.standing},
    }
    if budget.is_spent():
        evidence[CUT_SHORT] = True
    chosen = search.trial(best).fit
    return OrderChoice(best, evidence, warnings, None if chosen is None else chosen.chains)


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


def _remove_masses(best: Sizes, search: OrderSearch) -> Sizes:
    """Sizes with masses removed, cheapest first, as long as one is not needed."""
    while not budget.is_left_out("masses less on single axes"):
        smaller = [(*best[:i], n - 1, *best[i + 1 :]) for i, n in enumerate(best) if n > 1]
        removable = [s for s in smaller if np.isfinite(search.cost(s)) and not search.is_needed(s, best)]
        if not removable:
            return best
        best = min(removable, key=search.cost)
    return best


def _add_masses(best: Sizes, search: OrderSearch) -> Sizes:
    """Sizes with masses added to single branches as long as one is needed."""
    while True:
        larger = [(*best[:i], n + 1, *best[i + 1 :]) for i, n in enumerate(best) if n < search.most]
        better = [s for s in larger if search.is_needed(best, s)]
        if not better:
            return best
        best = min(better, key=search.cost)


def _equivalent_structures(best: Sizes, trials: dict[Sizes, OrderTrial]) -> list[Sizes]:
    """Other structures with as many masses that the data cannot tell from the best.

    Between two branches with coupled ends a mass may belong to the one or the other with the same motion of
    every motor, as long as all values stay positive.
    """
    scale = max(trials[best].cost / trials[best].dof, 1.0)
    # As good as the best up to what one parameter may gain by chance once in a thousand.
    limit = trials[best].cost + chi2_isf(1e-3, 1) * scale
    return [s for s, t in trials.items() if s != best and sum(s) == sum(best) and t.cost < limit]


def _split_final_masses(chains: CoupledChains | None, sizes: Sizes) -> list[CoupledChains]:
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


def _label(sizes: Sizes) -> str:
    return ",".join(str(n) for n in sizes)
