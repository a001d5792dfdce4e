"""Chains that are astray since a load has a mode or a base gives way: decided before any law is looked at.

From chains that lack one no later trial comes home.
"""

from __future__ import annotations

from invid.diagnosis.unknown_forces.resonances import Scan
from invid.diagnosis.unknown_forces.structures import Addition, Base, Mode, add, additions_of
from invid.identification.contest import (
    NOTHING,
    NUMBERS,
    Known,
    bent_axes,
    is_lost,
    is_settled,
    lowest_fit,
    settled_beside_springs,
    unexplained_axes,
    with_best_splits,
)
from invid.identification.own_time import tones_of
from invid.likelihood.unknown_forces.fitted_hypothesis import Bench, FittedHypothesis
from invid.likelihood.unknown_forces.price import price
from invid.model.plant import Structure

LEADERS = 2
"""Structures that are fitted to the end of those that a scan shows."""


def begin_with_structure(
    bench: Bench, structure: Structure, kept: Bench | None = None, known: Known = NOTHING
) -> FittedHypothesis:
    """The fit of chains with friction at the motors, and of a mode or base that they lack.

    Where a torque keeps its own time, only what leaves nothing: a light mode that swings from the start looks
    the same.
    """
    lowest = lowest_fit(bench, structure, kept, known)
    tied = settled_beside_springs(lowest, frozenset())
    if tied is not None:
        return tied
    shown = _with_what_scan_shows(lowest) if is_lost(lowest) else lowest
    starts = [shown, lowest] if is_settled(shown) or not tones_of(lowest) else [lowest]
    ends: list[FittedHypothesis] = []
    for start in dict.fromkeys(starts):
        ends.append(with_best_splits(start, bent_axes(start)))
        if not is_lost(ends[-1]):
            break
    return min(ends, key=_priced)


def _with_what_scan_shows(now: FittedHypothesis) -> FittedHypothesis:
    """The fit with the mode or base that explains most, by a scan from where the chains are; as it is where
    none does."""
    structure, looked = now.hypothesis.structure, Scan(now)
    tried: list[Addition] = [Mode(structure.load[axis]) for axis in unexplained_axes(now)]
    tried += [Base()] if structure.motors > 1 else []
    fits = [f for a in tried for f in (add(now, a, looked),) if f is not None and a.is_real(f)]
    ended = [f.refit() for f in sorted(fits, key=_priced)[:LEADERS]]
    return min((now, *ended), key=_priced)


def _priced(found: FittedHypothesis) -> float:
    """−2 ln L with the prices of what is beside the chains: of a mode, and again of what a base has more: it
    holds the mode of any load as a special case."""
    structure = found.hypothesis.structure
    more = [a.numbers(structure) - NUMBERS for a in additions_of(structure)]
    return found.total + sum(price(NUMBERS) + (price(k) if k else 0.0) for k in more)
