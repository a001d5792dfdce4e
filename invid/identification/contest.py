"""Where a search begins: chains that follow the motors' own stiffness, each to its end until one is home."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from invid.identification.first_plants import (
    chains_of_plant,
    closes,
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
Sizes = tuple[int, ...]
"""Masses of each axis."""
RANDOM = 12
"""Random splits where no continued fraction comes home: of one alone one in three does."""
BRIEF, TO_THE_END = 6, 40
"""Iterations after which starts are compared, and of those that go on."""
GO_ON = 5
"""Starts that go on: a value after few iterations says little of the end (empirical: of random splits of
three masses the fourth came home)."""
MOST_MASSES = 8
"""Masses of an axis beyond which none are sought."""
PRICE_OF_MASS = 120.0
"""Fall of −2 ln L on all records for one more mass: Schwarz's price of its three numbers is 25; the rest is
what the form of friction leaves, up to 83 (empirical, axes without a period of another hand)."""
AS_WELL = 10.0
"""Rise of −2 ln L up to which another structure with as many numbers does as well: odds of 150 to one."""
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
FURTHER_MASSES = "further masses"
"""What a spent budget leaves out without which the number of masses is open, in the words of the warning."""


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
    stacks = (*bench.stacks, *(kept.stacks if kept else ()))
    plants += fraction_plants(stacks, structure)
    if not all(closes(r) for s in stacks for r in s.records):
        plants += fraction_plants(stacks, structure, in_bands=True)
    if fewer is not None:
        plants += grown_plants(fewer.numbers.plant, structure, bench.stacks[0].records[0].top_hz)
    lowest, least = None, np.inf
    for plant in plants:
        found = _from_plant((bench, kept), hypothesis, plant, TO_THE_END)
        if found is None or found.total >= least:
            continue
        least = found.total
        # Of the right plant friction's form is all that is left.
        lowest = found if is_home(found) else reshape(scan_friction(found))
        if is_home(lowest) or budget.is_left_out("further starts"):
            break
    if lowest is None:
        splits = random_plants(bench.stacks, structure, RANDOM, np.random.default_rng(1))
        lowest = _contest((bench, kept), hypothesis, splits)
    if lowest is None:
        raise np.linalg.LinAlgError("no start of a chain of masses and springs has a value")
    for axis in _astray(lowest):
        if axis not in _astray(lowest) or budget.is_left_out("further starts"):
            continue
        # One chain after another: of several astray together none would come home.
        split = _contest((bench, kept), hypothesis, _splits(lowest, axis), axis)
        if split is not None and split.total < lowest.total:
            lowest = split if is_home(split) else reshape(scan_friction(split))
    return lowest


def _astray(now: Supposed) -> list[int]:
    """Axes in whose chains something unknown acts, the strongest first."""
    level = HOME * torque_rms(now.bench)
    strong = [s for v, s in now.strength if s.where is not Where.MOTOR and v > level]
    return list(dict.fromkeys(axis_of(now.hypothesis.structure, s) for s in strong))


def _splits(now: Supposed, axis: int) -> list[Plant]:
    """Random splits of one chain beside the others as they are."""
    structure, others = now.hypothesis.structure, chains_of_plant(now.numbers.plant)
    plants = random_plants(now.bench.stacks, structure, RANDOM, np.random.default_rng(1))
    return [
        plant_of_chains(
            structure,
            [own if i == axis else at for i, (own, at) in enumerate(zip(chains, others, strict=True))],
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
                moved.append(now.refit(numbers=_shaken(now, rng), iterations=BRIEF))
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


def begin_open(bench: Bench, motors: int, kept: Bench | None = None) -> tuple[Supposed, tuple[Sizes, ...]]:
    """The fit of as many masses as the records ask for, and other numbers of masses that do as well.

    Without a period the ends of a record blur a motor's own stiffness, and masses are tried one by one.
    """
    if all(r.periods for s in bench.stacks for r in s.records):
        return _begin_seen((bench, kept), motors)
    return _begin_grown((bench, kept), motors)


def _as_well(best: Supposed, tried: Sequence[Supposed]) -> tuple[Sizes, ...]:
    """Masses of other fits with as many numbers whose value is no worse."""
    count = sum(best.hypothesis.structure.sizes)
    near = [f.hypothesis.structure.sizes for f in tried if f is not best and f.total < best.total + AS_WELL]
    return tuple(sizes for sizes in near if sum(sizes) == count)


def _begin_seen(benches: Benches, motors: int) -> tuple[Supposed, tuple[Sizes, ...]]:
    """The fit of as many masses as each motor's own stiffness shows.

    Where that is not home, of one more on an axis or on all, if that is: else laws may be missing as well as
    masses, and the search has both.
    """
    bench, kept = benches
    sizes: Sizes = tuple(masses_seen(bench.stacks, m) for m in range(motors))
    now = begin(bench, Structure(sizes), kept)
    if is_settled(now):
        return now, ()
    wider = {tuple(n + (i == k) for k, n in enumerate(sizes)) for i in range(motors)}
    wider.add(tuple(n + 1 for n in sizes))
    tried = []
    for structure in map(Structure, sorted(wider)):
        if budget.is_left_out(FURTHER_MASSES):
            break
        hypothesis = Hypothesis(structure, first_shapes(bench.stacks))
        found = _contest(benches, hypothesis, fraction_plants(bench.stacks, structure))
        tried += [found] if found is not None and is_settled(found) else []
    best = min(tried, key=lambda f: f.total, default=now)
    more = sum(best.hypothesis.structure.sizes) - sum(sizes)
    pays = now.total - best.total > more * PRICE_OF_MASS and best.kept_total < now.kept_total
    return (best, _as_well(best, tried)) if pays else (now, ())


def _begin_grown(benches: Benches, motors: int) -> tuple[Supposed, tuple[Sizes, ...]]:
    """The fit of masses added one by one, on one axis after another or all at once.

    Orders are compared with friction's shapes at their best: what its form leaves asks for masses too.
    """
    bench, kept = benches
    now = reshape(scan_friction(begin(bench, Structure((1,) * motors), kept)))
    alike: tuple[Sizes, ...] = ()
    while max(now.hypothesis.structure.sizes) < MOST_MASSES and not budget.is_left_out(FURTHER_MASSES):
        sizes = now.hypothesis.structure.sizes
        wider = [tuple(n + (i == k) for k, n in enumerate(sizes)) for i in range(motors)]
        wider += [tuple(n + 1 for n in sizes)] if motors > 1 else []
        tried = []
        for one in wider:
            with suppress(np.linalg.LinAlgError):
                tried.append(begin(bench, Structure(one), kept, Known(fewer=now)))
        first = min(tried, key=lambda f: f.total, default=now)
        best = reshape(scan_friction(first))
        more = sum(best.hypothesis.structure.sizes) - sum(sizes)
        falls = now.total - best.total, now.kept_total - best.kept_total
        if sum(falls) < more * PRICE_OF_MASS or min(falls) < 0.0:
            break
        now, alike = best, _as_well(first, tried)
    return now, alike


def _contest(
    benches: Benches, hypothesis: Hypothesis, plants: Sequence[Plant], axis: int | None = None
) -> Supposed | None:
    first = [_from_plant(benches, hypothesis, p, BRIEF) for p in plants]
    return contest([f for f in first if f is not None], axis)


def contest(pool: Sequence[Supposed], axis: int | None = None) -> Supposed | None:
    """The best of several fits, each to its end until one is home, or its chain of one axis is."""
    best: Supposed | None = None
    for start in sorted(pool, key=lambda f: f.total)[:GO_ON]:
        found = start.refit(iterations=TO_THE_END)
        if best is None or found.total < best.total:
            best = found
        astray = _astray(best)
        if (not astray if axis is None else axis not in astray) or budget.is_left_out("further starts"):
            break
    return best


def _from_plant(benches: Benches, hypothesis: Hypothesis, plant: Plant, iterations: int) -> Supposed | None:
    stacks = benches[0].stacks
    timing = Timing.of_records(stacks)
    numbers = Numbers(plant, timing, first_strength(stacks, hypothesis.structure))
    try:
        return suppose(benches, hypothesis, numbers, iterations)
    except np.linalg.LinAlgError:
        return None
