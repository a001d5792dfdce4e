"""Chains that are astray since a load has a mode or a base gives way: decided before any law is looked at.

From chains that lack one no later trial comes home.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from invid.diagnosis.unknown_forces.resonances import Scan
from invid.diagnosis.unknown_forces.structures import Addition, Base, Mode, add, additions_of
from invid.identification.contest import (
    NOTHING,
    PRICE_OF_MASS,
    TO_THE_END,
    Axes,
    Known,
    all_stacks,
    astray,
    bent_axes,
    brought_home,
    fit_from,
    is_settled,
    lowest_fit,
    lowest_of,
    torque_rms,
)
from invid.identification.first_plants import with_chain_anew
from invid.identification.own_time import tones_of
from invid.likelihood.unknown_forces.forces import Where
from invid.likelihood.unknown_forces.motions import axis_of
from invid.likelihood.unknown_forces.motor_laws import first_shapes
from invid.likelihood.unknown_forces.plant import Kind, Plant, Structure
from invid.likelihood.unknown_forces.supposition import Bench, Hypothesis, Supposed
from invid.numerics import budget

LOST = 0.1
"""Unknown force behind the motors over the torque's rms from which a chain may lack a mode: what is weaker a
law explains from where the fit stands (empirical: 0.6 and more on cells of another hand that lacked one)."""
MODES = 2
"""Structures that are fitted to the end of those that a scan shows, and chains with a mode that are split."""


def begin_with_structure(
    bench: Bench, structure: Structure, kept: Bench | None = None, known: Known = NOTHING
) -> Supposed:
    """The fit of chains with friction at the motors, and of a mode or base that they lack.

    Where a torque keeps its own time, only what leaves nothing: a light mode that swings from the start looks
    the same.
    """
    lowest = lowest_fit(bench, structure, kept, known)
    ends: list[Supposed] = []
    for start in _starts(lowest):
        bent = bent_axes(start)
        end = brought_home(start, bent)
        ends.append(end)
        if not _lost_axes(end) or not _lost_axes(end) - (bent if end is start else bent_axes(end)):
            break
    return _without_idle_modes(min(ends, key=_priced))


def _starts(lowest: Supposed) -> Iterator[Supposed]:
    """The chains with what a scan shows, alone, and with modes from starts of their own."""
    shown = _with_what_scan_shows(lowest) if _lost_axes(lowest) else lowest
    keeps_time = bool(tones_of(lowest))
    if shown is not lowest and (is_settled(shown) or not keeps_time):
        yield shown
    yield lowest
    if _lost_axes(lowest) and not keeps_time:
        yield from sorted(_with_modes(lowest, bent_axes(lowest)), key=_priced)[:MODES]


def _lost_axes(now: Supposed) -> Axes:
    """Axes in whose chains so much acts that they may lack a mode."""
    level, structure = LOST * torque_rms(now.bench), now.hypothesis.structure
    return frozenset(
        axis_of(structure, s) for rms, s in now.strength if s.where is not Where.MOTOR and rms > level
    )


def _with_what_scan_shows(now: Supposed) -> Supposed:
    """The fit with the mode or base that explains most, by a scan from where the chains are; as it is where
    none does."""
    structure, looked = now.hypothesis.structure, Scan(now)
    tried: list[Addition] = [Mode(structure.load[axis]) for axis in astray(now)]
    tried += [Base()] if structure.motors > 1 else []
    fits = [f for a in tried for f in (add(now, a, looked),) if f is not None and a.is_real(f)]
    ended = [f.refit(iterations=TO_THE_END) for f in sorted(fits, key=_priced)[:MODES]]
    return min((now, *ended), key=_priced)


def _with_modes(now: Supposed, bent: Axes) -> list[Supposed]:
    """First fits of the chains with one mode more, on the load of each that is astray and not ``bent``."""
    structure, found = now.hypothesis.structure, []
    for axis in astray(now):
        if axis in bent:
            continue
        if budget.is_left_out("further starts"):
            break
        wider = Mode(structure.load[axis]).within(structure)
        hypothesis = Hypothesis(wider, first_shapes(now.bench.stacks))
        starts = with_chain_anew(all_stacks(now.bench, now.kept), now.numbers.plant, wider, axis)
        lowest = lowest_of((now.bench, now.kept), hypothesis, starts)
        found += [lowest] if lowest is not None else []
    return found


def _without_idle_modes(found: Supposed) -> Supposed:
    """The fit, or its chains alone where they do as well: that start may have been the better one."""
    if not found.hypothesis.structure.modes:
        return found
    chains = _chains_of(found.numbers.plant)
    hypothesis = replace(found.hypothesis, structure=chains.structure)
    plain = fit_from((found.bench, found.kept), hypothesis, chains)
    return found if plain is None or _priced(plain) > _priced(found) else plain


def _chains_of(plant: Plant) -> Plant:
    """The plant without its modes, whose numbers are the last of their kinds."""
    chains = Structure(plant.structure.sizes)
    counts = [chains.index(kind).stop - chains.index(kind).start for kind in Kind]
    own = [plant.of_kind(kind)[:count] for kind, count in zip(Kind, counts, strict=True)]
    return Plant.of_values(chains, np.concatenate(own))


def _priced(found: Supposed) -> float:
    structure = found.hypothesis.structure
    return found.total + PRICE_OF_MASS / 3.0 * sum(a.numbers(structure) for a in additions_of(structure))
