"""Where a search begins: chains that follow the motors' own stiffness, each to its end until one is home."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from invid.identification.first_plants import (
    chains_of_plant,
    fraction_plants,
    grown_plants,
    masses_seen,
    plant_of_chains,
    random_plants,
)
from invid.likelihood.unknown_forces.forces import Where
from invid.likelihood.unknown_forces.motor_laws import first_shapes
from invid.likelihood.unknown_forces.plant import Kind, Plant, Structure
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction
from invid.likelihood.unknown_forces.supposition import (
    Bench,
    Hypothesis,
    Supposed,
    axis_of,
    first_strength,
    suppose,
)
from invid.likelihood.unknown_forces.timing import Timing
from invid.likelihood.unknown_forces.value import Numbers
from invid.numerics import budget

Benches = tuple[Bench, Bench | None]
"""Records fitted and kept out."""
RANDOM = 12
"""Random splits where no continued fraction comes home: of one alone one in three does."""
ROUNDS = ((6, 4), (12, 2), (40, 1))
"""Iterations of each round, and how many of each class go on."""
MOST_MASSES = 8
"""Masses of an axis beyond which none are sought."""
PRICE_OF_MASS = 120.0
"""Fall of −2 ln L on all records for one more mass: Schwarz's price of its three numbers is 25; the rest is
what the form of friction leaves, up to 83 (empirical, axes without a period of another hand)."""
HOME, HOME_AT_MOTORS = 0.01, 0.03
"""Unknown force over the torque's rms, behind the motors and anywhere, below which a start is home: what
friction leaves before its shape is fitted stays below a fiftieth (empirical)."""


SHAKE, SHAKEN, SHAKES = 0.4, 8, 3
"""Deviation of the logarithms that are moved, how many times, and again at most (empirical: of 8 one in four
comes home)."""


def torque_rms(bench: Bench) -> float:
    """Rms of the torque on the likelihood's lines."""
    power = [(np.abs(s.parts.sum(axis=0)) ** 2 * s.weight[:, None]).sum(axis=1).mean() for s in bench.stacks]
    return float(np.sqrt(np.mean(power) / 2.0))


def is_home(found: Supposed) -> bool:
    """Return whether nothing unknown acts that counts."""
    return is_settled(found) and found.strength[0][0] < HOME_AT_MOTORS * torque_rms(found.bench)


def is_settled(found: Supposed) -> bool:
    """Return whether nothing unknown that counts acts behind the motors."""
    return found.inner_strength < HOME * torque_rms(found.bench)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known before a fit: one with ``fewer`` masses, from which starts are grown too and whose shapes
    of friction it begins with; a ``plant`` of its very structure, which is its first start."""

    fewer: Supposed | None = None
    plant: Plant | None = None


NOTHING = Known()


def begin(
    bench: Bench,
    structure: Structure,
    kept: Bench | None = None,
    known: Known = NOTHING,
) -> Supposed:
    """The fit of a structure with friction at the motors, from the first start at home, else the lowest."""
    fewer = known.fewer
    shapes = first_shapes(bench.stacks) if fewer is None else fewer.hypothesis.friction
    hypothesis = Hypothesis(structure, shapes)
    plants = [] if known.plant is None else [known.plant]
    # Where to start may be read from all records: as many as motors tell couplings apart.
    plants += fraction_plants((*bench.stacks, *(kept.stacks if kept else ())), structure)
    if fewer is not None:
        plants += grown_plants(fewer.numbers.plant, structure, bench.stacks[0].records[0].top_hz)
    lowest, least = None, np.inf
    for plant in plants:
        found = _from_plant((bench, kept), hypothesis, plant, ROUNDS[-1][0])
        if found is None or found.total >= least:
            continue
        least = found.total
        # Of the right plant friction's form is all that is left.
        lowest = found if is_home(found) else reshape(scan_friction(found))
        if is_home(lowest) or budget.is_left_out("further starts"):
            break
    if lowest is None or not (is_settled(lowest) or budget.is_left_out("further starts")):
        split = _contest((bench, kept), hypothesis, _splits(bench, structure, lowest))
        if split is not None and split.total < least:
            lowest = split if is_home(split) else reshape(scan_friction(split))
    if lowest is None:
        raise np.linalg.LinAlgError("no start of a chain of masses and springs has a value")
    return lowest


def _splits(bench: Bench, structure: Structure, lowest: Supposed | None) -> list[Plant]:
    """Random splits of every chain; beside a fit, of those alone in which something unknown acts."""
    plants = random_plants(bench.stacks, structure, RANDOM, np.random.default_rng(1))
    if lowest is None:
        return plants
    level = HOME * torque_rms(bench)
    astray = {axis_of(structure, s) for v, s in lowest.strength if s.where is not Where.MOTOR and v > level}
    home = chains_of_plant(lowest.numbers.plant)
    return [
        plant_of_chains(
            structure,
            [own if i in astray else at for i, (own, at) in enumerate(zip(chains, home, strict=True))],
        )
        for chains in map(chains_of_plant, plants)
    ]


def shaken(now: Supposed, rng: np.random.Generator) -> Supposed:
    """The lowest end about a fit that is not home: masses and springs moved at random, again from what is
    better.

    Unknown forces as strong as they are make the way home smooth.
    """
    for _ in range(SHAKES):
        if is_settled(now) or budget.is_left_out("further starts"):
            break
        moved = []
        for _ in range(SHAKEN):
            with suppress(np.linalg.LinAlgError):
                moved.append(now.refit(numbers=_shaken(now, rng), iterations=ROUNDS[0][0]))
        found = contest(moved)
        if found is None or now.total - found.total < PRICE_OF_MASS:
            break
        now = found
    return now


def _shaken(now: Supposed, rng: np.random.Generator) -> Numbers:
    plant, structure = now.numbers.plant, now.hypothesis.structure
    x = plant.x.copy()
    for kind in (Kind.MASS, Kind.SPRING):
        at = structure.index(kind)
        x[at] += SHAKE * rng.standard_normal(at.stop - at.start)
    return replace(now.numbers, plant=plant.moved(x))


def begin_open(bench: Bench, motors: int, kept: Bench | None = None) -> Supposed:
    """The fit of as many masses as the records ask for.

    Without a period the ends of a record blur a motor's own stiffness, and masses are tried one by one.
    """
    if all(r.periods for s in bench.stacks for r in s.records):
        return _begin_seen((bench, kept), motors)
    return _begin_grown((bench, kept), motors)


def _begin_seen(benches: Benches, motors: int) -> Supposed:
    """The fit of as many masses as each motor's own stiffness shows.

    Where that is not home, of one more on an axis or on all, if that is: else laws may be missing as well as
    masses, and the search has both.
    """
    bench, kept = benches
    sizes = tuple(masses_seen(bench.stacks, m) for m in range(motors))
    now = begin(bench, Structure(sizes), kept)
    if is_settled(now):
        return now
    wider = {tuple(n + (i == k) for k, n in enumerate(sizes)) for i in range(motors)}
    wider.add(tuple(n + 1 for n in sizes))
    tried = []
    for structure in map(Structure, sorted(wider)):
        if budget.is_left_out("further masses"):
            break
        hypothesis = Hypothesis(structure, first_shapes(bench.stacks))
        tried.append(_contest(benches, hypothesis, fraction_plants(bench.stacks, structure)))
    best = min((f for f in tried if f is not None and is_settled(f)), key=lambda f: f.total, default=now)
    more = sum(best.hypothesis.structure.sizes) - sum(sizes)
    pays = now.total - best.total > more * PRICE_OF_MASS and best.kept_total < now.kept_total
    return best if pays else now


def _begin_grown(benches: Benches, motors: int) -> Supposed:
    """The fit of masses added one by one, on one axis after another or all at once.

    Orders are compared with friction's shapes at their best: what its form leaves asks for masses too.
    """
    bench, kept = benches
    now = reshape(scan_friction(begin(bench, Structure((1,) * motors), kept)))
    while max(now.hypothesis.structure.sizes) < MOST_MASSES and not budget.is_left_out("further masses"):
        sizes = now.hypothesis.structure.sizes
        wider = [tuple(n + (i == k) for k, n in enumerate(sizes)) for i in range(motors)]
        wider += [tuple(n + 1 for n in sizes)] if motors > 1 else []
        tried = []
        for one in wider:
            with suppress(np.linalg.LinAlgError):
                tried.append(begin(bench, Structure(one), kept, Known(fewer=now)))
        best = reshape(scan_friction(min(tried, key=lambda f: f.total, default=now)))
        more = sum(best.hypothesis.structure.sizes) - sum(sizes)
        falls = now.total - best.total, now.kept_total - best.kept_total
        if sum(falls) < more * PRICE_OF_MASS or min(falls) < 0.0:
            break
        now = best
    return now


def _contest(benches: Benches, hypothesis: Hypothesis, plants: Sequence[Plant]) -> Supposed | None:
    first = [_from_plant(benches, hypothesis, p, ROUNDS[0][0]) for p in plants]
    return contest([f for f in first if f is not None])


def contest(pool: Sequence[Supposed]) -> Supposed | None:
    """The best of several fits, run further in rounds."""
    fits = sorted(pool, key=lambda f: f.total)[: ROUNDS[0][1]]
    for iterations, kept in ROUNDS[1:]:
        if budget.is_left_out("further starts") and fits:
            break
        fits = sorted((f.refit(iterations=iterations) for f in fits), key=lambda f: f.total)[:kept]
    return fits[0] if fits else None


def _from_plant(benches: Benches, hypothesis: Hypothesis, plant: Plant, iterations: int) -> Supposed | None:
    stacks = benches[0].stacks
    timing = Timing.nominal(hypothesis.structure.motors, stacks[0].step)
    numbers = Numbers(plant, timing, first_strength(stacks, hypothesis.structure))
    try:
        return suppose(benches, hypothesis, numbers, iterations)
    except np.linalg.LinAlgError:
        return None
