"""The search: laws and structures that lower −2 ln L by more than their price, one after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.unknown_forces.resonances import Scan
from invid.diagnosis.unknown_forces.scoring import candidates, own_share, score
from invid.diagnosis.unknown_forces.structures import (
    LEAST_FALL,
    Addition,
    Base,
    Mode,
    add,
    additions,
    additions_of,
    without,
)
from invid.effects.catalogue.backlash import BacklashLaw
from invid.effects.supposed.law import SupposedLaw
from invid.effects.supposed_laws import SUPPOSED
from invid.identification.late_drives import late_drives
from invid.likelihood.unknown_forces.background import ALIKE
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis, excess
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.price import FITTED, NUMBER, pays, price
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction, smoothed_with_shapes, with_law
from invid.likelihood.unknown_forces.worth import role_falls
from invid.model.plant import Kind
from invid.numerics import budget

PROMISING = 0.3
"""Share of the best fall from which a structure is fitted to its end (empirical)."""
REFINED = 4
"""Leaders of the scores that are fitted."""
OWN_STIFFNESS = (0.7, 1.4)
"""Bounds of a gap's coefficient over its spring's stiffness."""
UNBENT = 0.2
"""Relative deviation of a spring's stiffness from which on no record bends it (empirical)."""
ALONE, STANDS = 8, 0.03
"""Most rounds in which motion is made to agree with laws of springs where nothing unknown acts beside them,
and the share of all that they gained below which one gains nothing (empirical: they come to rest in six)."""
NEAR_END = 20.0
"""Rise of −2 ln L up to which motion that is smoothed anew is that of the same end: numbers moved with it."""
MOST = 0.5
"""Share of what is in excess of the sensors from which beside a law no other structure is supposed."""

Tell = Callable[[FittedHypothesis, float], None]
"""Given what is found so far, and the share of the search that lies behind."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis with one cause more."""

    cause: str
    spot: Spot
    found: FittedHypothesis
    base: FittedHypothesis
    """The hypothesis without it."""
    placed: PlacedLaw | None = None
    """The law, where it is one."""
    addition: Addition | None = None
    """What is added to the structure, where it is that."""

    @property
    def fall(self) -> float:
        """Fall of −2 ln L."""
        return self.base.total - self.found.total

    def holds(self, other: Trial) -> bool:
        """Return whether another one is a special case of it: it does as well, and speaks for nothing."""
        return isinstance(self.addition, Base) and isinstance(other.addition, Mode)

    @property
    def numbers(self) -> int:
        """Numbers that it brings."""
        if self.addition is not None:
            return self.addition.numbers(self.found.hypothesis.structure)
        return 1 if self.placed is None else len(self.placed.law.low) + len(self.placed.shape)

    @property
    def merit(self) -> float:
        """The fall less what its numbers cost beyond the first: of two that do as well the simpler one is
        taken."""
        return self.fall - NUMBER * (self.numbers - 1)

    @property
    def pays(self) -> bool:
        """Whether it pays its price, which contains what the places and shapes of laws cost, however far the
        hypothesis without it may still fall."""
        fitted, kept = role_falls(self.base, self.found)
        return pays(
            fitted - self.base.fit.open_gap, kept, price(1 if self.addition is None else self.numbers)
        )


def is_sound(found: FittedHypothesis) -> bool:
    """Return whether every gap lies within its spring's motion and takes away that spring's own stiffness.

    Of a spring that no record bends nothing is known, so no gap in it either.
    """
    plant = found.numbers.plant
    names = [c.name for c in found.fit.problem.columns]
    springs = plant.of_kind(Kind.SPRING)
    deviation = np.sqrt(np.diag(found.fit.covariance))[plant.structure.index(Kind.SPRING)]
    for placed in found.hypothesis.laws:
        if (placed.law.reads or placed.law.scales) and _is_at_bound(found, placed):
            return False
        if not isinstance(placed.law, BacklashLaw):
            continue
        number = placed.spot.number
        size = found.fit.value.coefficients[names.index((*placed.key, 0))] / springs[number]
        top = placed.law.bounds(found.motions.flat(placed.spot))[0][1]
        if (
            not OWN_STIFFNESS[0] < size < OWN_STIFFNESS[1]
            or placed.shape[0] >= top
            or deviation[number] > UNBENT
        ):
            return False
    return True


def _is_at_bound(found: FittedHypothesis, placed: PlacedLaw) -> bool:
    """Whether a coefficient of a law is at its bound."""
    names = [c.name for c in found.fit.problem.columns]
    return not all(found.fit.value.free[names.index((*placed.key, i))] for i in range(len(placed.law.low)))


def _agreed_alone(now: FittedHypothesis) -> FittedHypothesis:
    """The fit on motion across springs that agrees with their laws, followed where nothing unknown acts
    beside them.

    What the law misses while its motion is not yet right a force at a neighbouring place takes up; motion
    that is smoothed with that force needs it, and the two hold each other.
    """
    found = lowest = now.with_forces_at_laws()
    for number in range(ALONE):
        found = reshape(found.renewed(agreed=True), 1).with_kept_agreed()
        gained = lowest.total - found.total
        lowest = found if gained > 0 else lowest
        if number and gained < STANDS * (now.total - lowest.total):
            break
    return lowest.with_forces_anywhere()


def settle(now: FittedHypothesis, rounds: int = 5) -> FittedHypothesis:
    """Motion, shapes and numbers in turn until the value stands."""
    if now.has_contact and not now.motions.is_agreed:
        now = min(now, _agreed_alone(now), key=lambda f: f.total)
    for _ in range(rounds):
        moved = now.with_agreed_motors()
        if now.follows_fit:
            ways = (True,) if moved.motions.is_agreed else moved.ways
            moved = min((moved.renewed(agreed=a) for a in ways), key=lambda f: f.total)
        moved = reshape(moved)
        gained = now.total - moved.total
        if gained > 0:
            now = moved
        if gained < 4.0:
            break
    return now


def try_channels(now: FittedHypothesis) -> list[Trial]:
    """Drives whose torque acts late by more than a sample, or lags, each against no such thing."""
    return [
        Trial(late.channel.value, Spot(Where.MOTOR, late.axis), late.found, late.without)
        for late in late_drives(now)
    ]


def try_structures(
    now: FittedHypothesis, least: float, *, growing: bool, start: FittedHypothesis | None = None
) -> list[Trial]:
    """A mode, a base, one more mass of a chain, each where a scan over frequency says that it may be.

    What falls by less than a share of ``least``, or of the best of them, is not fitted to its end. ``start``:
    the same structure with the numbers to scan and to begin from, else those of ``now``.
    """
    start = start or now
    looked = Scan(start)
    structure = now.hypothesis.structure
    begun = [(a, add(start, a, looked)) for a in additions(start, looked, growing=growing)]
    known = [(a, found) for a, found in begun if found is not None]
    least = now.total - PROMISING * max([least, *(now.total - found.total for _, found in known)])
    trials = [
        Trial(a.cause, a.spot(structure), found.refit(), now, addition=a)
        for a, found in known
        if found.total < least
    ]
    return [t for t in trials if t.addition is not None and t.addition.is_real(t.found)]


def reconsider_structure(now: FittedHypothesis) -> tuple[FittedHypothesis, tuple[tuple[Trial, Trial], ...]]:
    """The fit with the best of every mode, base and what may stand in its place, and its rivals.

    When a part of the structure was taken, what was found since was not known: the mode of one load is a base
    as well, and starts beside what was missing end elsewhere.
    """
    rivals: list[tuple[Trial, Trial]] = []
    for own in additions_of(now.hypothesis.structure):
        if budget.is_left_out(budget.FURTHER_CAUSES):
            break
        less = without(now, own)
        taken = Trial(own.cause, own.spot(less.hypothesis.structure), now, less, addition=own)
        # The fit without it has bent the chains: what may stand in its place is seen from where they were.
        start = without(now, own, 0)
        tried = try_structures(less, taken.fall, growing=False, start=start)
        others = [t for t in tried if t.addition != own]
        # What holds it as a special case does as well: its further freedom has to pay by itself.
        paid = [t for t in others if not t.holds(taken) or pays(*role_falls(now, t.found), price())]
        best = max((taken, *paid), key=lambda t: t.merit)
        now = now if best is taken else settle(best.found)
        best = replace(best, found=now)
        rivals += [(best, t) for t in (taken, *others) if t.addition != best.addition and not t.holds(best)]
    return now, tuple(rivals)


@dataclass(frozen=True, eq=False)
class SearchEnd:
    """Where a search ended, and the rivals of each cause that it took on the way."""

    end: FittedHypothesis
    rivals: tuple[tuple[Trial, Trial], ...]
    """Taken, and beside it what did nearly as well."""


NEARLY_AS_WELL = 0.15
"""Share of the fall of the cause taken that a rival may miss and is looked at again at the end."""


def finish(trials: Sequence[Trial]) -> list[Trial]:
    """The trials, the best first; those that come near the best are fitted to the end before they are
    compared."""
    best = max((t.merit for t in trials), default=0.0)
    close = [t for t in trials if t.merit > best - max(NEARLY_AS_WELL * best, FITTED * price())]
    if len(close) > 1:
        ended = {id(t): replace(t, found=t.found.refit()) for t in close}
        trials = [ended.get(id(t), t) for t in trials]
    return sorted(trials, key=lambda t: -t.merit)


def search_causes(
    now: FittedHypothesis,
    laws: Sequence[SupposedLaw] = SUPPOSED,
    tell: Tell = lambda _, __: None,
    rounds: int = 8,
    *,
    growing: bool = False,
) -> SearchEnd:
    """Causes taken one after another, each the one that lowers −2 ln L most, until none pays its price.

    ``growing``: the number of masses is not known, and chains may become longer.
    """
    rivals: list[tuple[Trial, Trial]] = []
    now = settle(reshape(scan_friction(now)))
    for number in range(rounds):
        tell(now, number / rounds)
        if budget.is_left_out(budget.FURTHER_CAUSES):
            break
        renewed = now.renewed()
        # Across a law motion may come to rest elsewhere; without one it is only smoothed.
        if renewed.total < now.total + NEAR_END or not now.motions.smoothed:
            now = still = renewed
        else:
            # A cause has to do better than the lowest fit without it, wherever its own motion came to rest.
            still = min(now, smoothed_with_shapes(now), key=lambda f: f.total)
        looked = candidates(now, laws)
        falls = score(now, looked)
        trials: list[Trial] = []
        tried: set[tuple[str, Spot, int]] = set()
        for k in np.argsort(-falls):
            placed = looked[int(k)]
            if falls[k] < LEAST_FALL or len(tried) >= REFINED:
                break
            if placed.key in tried or budget.is_left_out(budget.FURTHER_CAUSES):
                continue
            tried.add(placed.key)
            found = with_law(now, placed)
            if is_sound(found) and own_share(found, found.hypothesis.laws[-1]) > ALIKE:
                base = still if placed.needs_fit else now
                trials.append(Trial(placed.law.cause, placed.spot, found, base, placed))
        best = max((t.fall for t in trials), default=0.0)
        if best < MOST * excess(now) and not budget.is_left_out(budget.FURTHER_CAUSES):
            trials += try_structures(now, best, growing=growing)
        trials += try_channels(now)
        trials = finish(trials)
        taken = next((t for t in trials if t.pays), None)
        if taken is None:
            break
        close = taken.fall - max(NEARLY_AS_WELL * taken.fall, FITTED * price())
        rivals += [(taken, t) for t in trials if t is not taken and t.fall > close]
        now = settle(reshape(scan_friction(taken.found)))
    now, beside = reconsider_structure(now)
    return SearchEnd(now, (*(r for r in rivals if r[0].addition is None), *beside))
