"""Where a search begins: chains that follow the motors' own stiffness, each to its end until one is home."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from invid.effects.catalogue.backlash import BacklashLaw
from invid.effects.catalogue.cubic_stiffness import CubicStiffnessLaw
from invid.identification.first_plants import (
    IN_BANDS,
    RUBBING,
    TIED,
    chain_lengths,
    closes,
    fraction_plants,
    grown_plants,
    masses_seen,
    random_plants,
    split_plants,
)
from invid.likelihood.unknown_forces.fitted_hypothesis import (
    Bench,
    FittedHypothesis,
    Hypothesis,
    first_strength,
    fit_hypothesis,
)
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw, axis_of
from invid.likelihood.unknown_forces.motor_laws import first_shapes
from invid.likelihood.unknown_forces.price import price
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction, with_law
from invid.likelihood.unknown_forces.timing import Timing
from invid.likelihood.unknown_forces.value import Numbers
from invid.model.plant import Plant, Structure
from invid.numerics import budget
from invid.wording.sentence import sentence

Benches = tuple[Bench, Bench | None]
"""Records fitted and kept out."""
Sizes = tuple[int, ...]
"""Masses of each axis."""
RANDOM = 12
"""Random splits where no continued fraction comes home: of one alone one in three does."""
BRIEF, FAR = 8, 40
"""Iterations after which random splits are ranked, and starts that are read from the records: the lowest are
finished."""
GO_ON = 5
"""Starts that go on: a value after few iterations says little of the end (empirical: of random splits of
three masses the fourth came home)."""
MOST_MASSES = 8
"""Masses of an axis beyond which none are sought."""
NUMBERS = 3
"""Numbers of one more mass: itself, its spring and its damper."""
PASSES = 2
"""Times that every chain astray is split, again where that made it better."""
AS_WELL = 10.0
"""Rise of −2 ln L up to which another structure with as many numbers does as well: odds of 150 to one."""
NEGLIGIBLE, NEGLIGIBLE_AT_MOTORS = 0.01, 0.03
"""Unknown force over the torque's rms, behind the motors and anywhere, below which a start is home: what
friction leaves before its shape is fitted stays below a fiftieth (empirical)."""

LOST = 0.1
"""Unknown force behind the motors over the torque's rms from which a chain may lack a mode: what is weaker a
law explains from where the fit stands (empirical: 0.6 and more on cells of another hand that lacked one)."""


def torque_rms(bench: Bench) -> float:
    """Rms of the torque on the likelihood's lines."""
    power = [(np.abs(s.parts.sum(axis=0)) ** 2 * s.weight[:, None]).sum(axis=1).mean() for s in bench.stacks]
    return float(np.sqrt(np.mean(power) / 2.0))


def leaves_nothing(found: FittedHypothesis) -> bool:
    """Return whether nothing unknown acts that counts."""
    return is_settled(found) and found.strength[0][0] < NEGLIGIBLE_AT_MOTORS * torque_rms(found.bench)


def is_settled(found: FittedHypothesis) -> bool:
    """Return whether nothing unknown that counts acts behind the motors."""
    return found.inner_strength < NEGLIGIBLE * torque_rms(found.bench)


def is_lost(found: FittedHypothesis) -> bool:
    """Return whether so much acts behind the motors that no law explains it from where the fit stands."""
    return found.inner_strength > LOST * torque_rms(found.bench)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known before a fit: one with ``fewer`` masses, from which starts are grown too and whose shapes
    of friction it begins with; a ``plant`` of its very structure, which is its first start."""

    fewer: FittedHypothesis | None = None
    plant: Plant | None = None


NOTHING = Known()
Axes = frozenset[int]
SPRING_LAWS = (CubicStiffnessLaw(), BacklashLaw())
TAKEN_UP = 0.85
"""Unknown force in a spring that its own law leaves (empirical, nineteen cells of another hand: at most 0.70
with play and 0.01 with hardening, at least 0.89 where a chain lacks a mode or is astray)."""
FURTHER_STARTS = sentence("further starts")
FURTHER_MASSES = sentence("further masses")
"""What a spent budget leaves out without which the number of masses is open, in the words of the warning."""


def begin(
    bench: Bench, structure: Structure, kept: Bench | None = None, known: Known = NOTHING
) -> FittedHypothesis:
    """The fit of a structure with friction at the motors, from the first start at home, else the lowest."""
    lowest = lowest_fit(bench, structure, kept, known)
    return with_best_splits(lowest, bent_axes(lowest))


def lowest_fit(bench: Bench, structure: Structure, kept: Bench | None, known: Known) -> FittedHypothesis:
    """The first fit at home of what is known and of continued fractions, else the lowest; random splits where
    those have no value."""
    fewer = known.fewer
    shapes = first_shapes(bench.stacks) if fewer is None else fewer.hypothesis.friction
    hypothesis = Hypothesis(structure, shapes)
    lowest, least = None, np.inf
    for plant in _starts(bench, structure, kept, known):
        found = _fit_from((bench, kept), hypothesis, plant, FAR, least)
        if found is None or found.total >= least:
            continue
        least = found.total
        # Of the right plant friction's form is all that is left.
        lowest = found.refit() if leaves_nothing(found) else reshape(scan_friction(found))
        if leaves_nothing(lowest) or budget.is_left_out(FURTHER_STARTS):
            break
    if lowest is None:
        splits = random_plants(bench.stacks, structure, RANDOM, np.random.default_rng(1))
        lowest = _contest((bench, kept), hypothesis, splits)
    if lowest is None:
        raise np.linalg.LinAlgError("no start of a chain of masses and springs has a value")
    return lowest


def _starts(bench: Bench, structure: Structure, kept: Bench | None, known: Known) -> Iterator[Plant]:
    """What is known, and continued fractions."""
    if known.plant is not None:
        yield known.plant
    # Where to start may be read from all records: as many as motors tell couplings apart.
    stacks = (*bench.stacks, *(kept.stacks if kept else ()))
    yield from fraction_plants(stacks, structure)
    yield from fraction_plants(stacks, structure, RUBBING)
    if not all(closes(r) for s in stacks for r in s.records):
        yield from fraction_plants(stacks, structure, IN_BANDS)
    if known.fewer is not None:
        yield from grown_plants(known.fewer.numbers.plant, structure, bench.stacks[0].records[0].top_hz)


def with_best_splits(now: FittedHypothesis, bent: Axes) -> FittedHypothesis:
    """The lowest end of chains that are split anew where something unknown acts; where that is most between
    two loads, of chains that were followed beside springs there as well.

    Those of ``bent`` axes stay.
    """
    end = _with_splits(now, bent)
    if not acts_between_loads(end):
        return end
    return min(end, _with_splits(_beside_springs(now), bent), key=lambda f: f.total)


def settled_beside_springs(now: FittedHypothesis, bent: Axes) -> FittedHypothesis | None:
    """The fit at home from chains that were followed beside springs between loads, where most acts between
    two; ``None`` where it is not home, or something else acts most."""
    if not acts_between_loads(now):
        return None
    tied = _with_splits(_beside_springs(now), bent)
    return None if unexplained_axes(tied) else min(now, tied, key=lambda f: f.total)


def acts_between_loads(now: FittedHypothesis) -> bool:
    """Return whether most acts between two loads, and no base moves under them."""
    first = next(iter(unexplained_axes(now).values()), None)
    return first is not None and first.where is Where.PAIR and not now.hypothesis.structure.base


def _beside_springs(now: FittedHypothesis) -> FittedHypothesis:
    """The lowest fit from chains that follow the motors' own stiffness beside springs between loads; as it is
    where none has a value."""
    benches = now.bench, now.kept
    hypothesis = Hypothesis(now.hypothesis.structure, first_shapes(now.bench.stacks))
    stacks = (*now.bench.stacks, *(now.kept.stacks if now.kept else ()))
    best: FittedHypothesis | None = None
    for plant in fraction_plants(stacks, hypothesis.structure, TIED):
        if budget.is_left_out(FURTHER_STARTS):
            break
        found = _fit_from(benches, hypothesis, plant, FAR, np.inf if best is None else best.total)
        best = found if found is not None and (best is None or found.total < best.total) else best
    return now if best is None else reshape(scan_friction(best))


def _with_splits(now: FittedHypothesis, bent: Axes) -> FittedHypothesis:
    """The lowest end of random splits of the chains in which something unknown acts, one after another: of
    several together none would come home. Again from what is better: beside a chain at home others follow."""
    rng = np.random.default_rng(1)
    for _ in range(PASSES):
        before = now
        for axis in unexplained_axes(now):
            worst = unexplained_axes(now).get(axis)
            if worst is None or axis in bent or budget.is_left_out(FURTHER_STARTS):
                continue
            now = _split_anew(now, (axis, _masses_before(now.hypothesis.structure, axis, worst)), rng)
        if before.total - now.total < price(NUMBERS) or not unexplained_axes(now):
            break
    return now


def _split_anew(now: FittedHypothesis, place: tuple[int, int], rng: np.random.Generator) -> FittedHypothesis:
    """The lowest of random splits of one chain: of all of it, and of what is behind the first place at which
    something acts, its first mass and spring at least.

    ``place``: the axis, and its masses before that place.
    """
    (axis, before), stacks, plant = place, now.bench.stacks, now.numbers.plant
    longest = chain_lengths(now.hypothesis.structure)[axis] - 1
    kept = sorted({0, min(max(1, before), longest)})
    splits = [s for k in kept for s in split_plants(stacks, plant, (axis, k), RANDOM // len(kept), rng)]
    best = _contest((now.bench, now.kept), now.hypothesis, splits, axis)
    if best is None or best.total >= now.total:
        return now
    return best if leaves_nothing(best) else reshape(scan_friction(best))


def unexplained_axes(now: FittedHypothesis) -> dict[int, Spot]:
    """Axes in whose chains something unknown acts, the strongest first, each with its strongest place."""
    level, structure = NEGLIGIBLE * torque_rms(now.bench), now.hypothesis.structure
    out: dict[int, Spot] = {}
    for strength, spot in now.strength:
        if spot.where is not Where.MOTOR and strength > level:
            out.setdefault(axis_of(structure, spot), spot)
    return out


def _masses_before(structure: Structure, axis: int, spot: Spot) -> int:
    """Masses of an axis before a place; none before one between two loads."""
    if spot.where is Where.PAIR:
        return 0
    at = structure.links[spot.number][0] if spot.where is Where.SPRING else spot.number
    return min(at, structure.load[axis]) - structure.motor[axis]


def bent_axes(now: FittedHypothesis) -> Axes:
    """Axes on which most acts in a spring and free play or hardening of that spring takes it up: no other
    chain explains that, and beside it no start is at home."""
    worst = {axis: spot for axis, spot in unexplained_axes(now).items() if spot.where is Where.SPRING}
    now = now.with_motion() if worst else now
    before, out = {spot: rms for rms, spot in now.strength}, set()
    for axis, spot in worst.items():
        for law in SPRING_LAWS:
            shapes = law.shapes(now.motions.flat(spot))
            if budget.is_left_out(FURTHER_STARTS) or not shapes:
                break
            found = with_law(now, PlacedLaw(law, spot, shapes[len(shapes) // 2]))
            if {s: rms for rms, s in found.strength}[spot] < TAKEN_UP * before[spot]:
                out.add(axis)
                break
    return frozenset(out)


def begin_open(
    bench: Bench, motors: int, kept: Bench | None = None
) -> tuple[FittedHypothesis, tuple[Sizes, ...]]:
    """The fit of as many masses as the records ask for, and other numbers of masses that do as well.

    Without a period the ends of a record blur a motor's own stiffness, and masses are tried one by one.
    """
    if all(r.periods for s in bench.stacks for r in s.records):
        return _begin_seen((bench, kept), motors)
    return _begin_grown((bench, kept), motors)


def _as_well(best: FittedHypothesis, tried: Sequence[FittedHypothesis]) -> tuple[Sizes, ...]:
    """Masses of other fits with as many numbers whose value is no worse."""
    count = sum(best.hypothesis.structure.sizes)
    near = [f.hypothesis.structure.sizes for f in tried if f is not best and f.total < best.total + AS_WELL]
    return tuple(sizes for sizes in near if sum(sizes) == count)


def _begin_seen(benches: Benches, motors: int) -> tuple[FittedHypothesis, tuple[Sizes, ...]]:
    """The fit of as many masses as each motor's own stiffness shows.

    Of one more on an axis that is astray and that no spring's own law brings back, or on all of those, if
    that is home: else laws may be missing as well as masses, and the search has both.
    """
    bench, kept = benches
    sizes: Sizes = tuple(masses_seen(bench.stacks, m) for m in range(motors))
    lowest = lowest_fit(bench, Structure(sizes), kept, NOTHING)
    bent = bent_axes(lowest)
    now = settled_beside_springs(lowest, bent) or with_best_splits(lowest, bent)
    short = [axis for axis in sorted(unexplained_axes(now)) if axis not in bent]
    wider = {tuple(n + (i == k) for k, n in enumerate(sizes)) for i in short}
    if len(short) > 1:
        wider.add(tuple(n + (i in short) for i, n in enumerate(sizes)))
    tried = []
    for structure in map(Structure, sorted(wider)):
        if budget.is_left_out(FURTHER_MASSES):
            break
        hypothesis = Hypothesis(structure, first_shapes(bench.stacks))
        found = _contest(benches, hypothesis, fraction_plants(bench.stacks, structure))
        tried += [found] if found is not None and is_settled(found) else []
    best = min(tried, key=lambda f: f.total, default=now)
    more = sum(best.hypothesis.structure.sizes) - sum(sizes)
    pays = now.total - best.total > price(NUMBERS * more) and best.kept_total < now.kept_total
    return (best, _as_well(best, tried)) if pays else (now, ())


def _begin_grown(benches: Benches, motors: int) -> tuple[FittedHypothesis, tuple[Sizes, ...]]:
    """The fit of masses added one by one, on one axis after another or all at once.

    Orders are compared with friction's shapes at their best, on motion that agrees with it: what its form
    leaves, and a motor that sticks, asks for masses too.
    """
    bench, kept = benches
    now = _with_friction_at_best(begin(bench, Structure((1,) * motors), kept))
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
        best = _with_friction_at_best(first)
        more = sum(best.hypothesis.structure.sizes) - sum(sizes)
        falls = now.total - best.total, now.kept_total - best.kept_total
        if sum(falls) < price(NUMBERS * more) or min(falls) < 0.0:
            break
        now, alike = best, _as_well(first, tried)
    return now, alike


def _with_friction_at_best(found: FittedHypothesis) -> FittedHypothesis:
    return reshape(reshape(scan_friction(found)).with_agreed_motors())


def _contest(
    benches: Benches, hypothesis: Hypothesis, plants: Sequence[Plant], axis: int | None = None
) -> FittedHypothesis | None:
    first = [_fit_from(benches, hypothesis, p, BRIEF) for p in plants]
    return contest([f for f in first if f is not None], axis)


def contest(pool: Sequence[FittedHypothesis], axis: int | None = None) -> FittedHypothesis | None:
    """The best of several fits, each to its end until one is home, or its chain of one axis is."""
    best: FittedHypothesis | None = None
    for start in sorted(pool, key=lambda f: f.total)[:GO_ON]:
        found = start.refit(target=np.inf if best is None else best.total)
        if best is None or found.total < best.total:
            best = found
        away = unexplained_axes(best)
        if (not away if axis is None else axis not in away) or budget.is_left_out(FURTHER_STARTS):
            break
    return best


def _fit_from(
    benches: Benches, hypothesis: Hypothesis, plant: Plant, iterations: int, target: float = np.inf
) -> FittedHypothesis | None:
    """The fit of a hypothesis from a plant; none where it has no value."""
    stacks = benches[0].stacks
    timing = Timing.of_records(stacks)
    numbers = Numbers(plant, timing, first_strength(stacks, hypothesis.structure))
    try:
        return fit_hypothesis(benches, hypothesis, numbers, iterations, target)
    except np.linalg.LinAlgError:
        return None
