"""The search: laws and structures that lower −2 ln L by more than their price, one after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.unknown_forces.scoring import candidates, score
from invid.effects.supposed_laws import SUPPOSED, Backlash, SupposedLaw
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.plant import Kind, Plant, Structure
from invid.likelihood.unknown_forces.shapes import reshape, scan_friction
from invid.likelihood.unknown_forces.supposition import Channel, Hypothesis, PlacedLaw, Supposed, carry_over
from invid.likelihood.unknown_forces.timing import EXPECTED_DELAY
from invid.likelihood.unknown_forces.value import Numbers
from invid.numerics import budget

PRICE, LEAST_FITTED, LEAST_KEPT = 120.0, 40.0, 10.0
"""Fall of −2 ln L that a cause must bring on all records, on those fitted and on those kept out.

Schwarz's price of its numbers, and of the places and shapes looked at, is about 40; the rest is what the form
of friction and the grid of motion leave (empirical: false falls of up to 60 of −ln L in sixty rounds of whole
cells of another hand).
"""
REFINED = 4
"""Leaders of the scores that are fitted."""
MODE_SHARES, MODE_BANDS, MODE_STARTS = (0.2, 0.45), (0.2, 0.3, 0.42, 0.58, 0.8, 1.1), 3
"""Starts of one more mass: its share of its load, its frequency over the highest excited one; how many are
fitted."""
MODE_MASS, MODE_BAND = (0.02, 2.0), (0.04, 1.6)
"""Bounds of its mass over its chain's and of its frequency over the highest excited one."""
OWN_STIFFNESS = (0.7, 1.4)
"""Bounds of a gap's coefficient over its spring's stiffness."""
UNBENT = 0.2
"""Relative deviation of a spring's stiffness from which on no record bends it (empirical)."""
SURELY_LATE = 5.0
"""Deviations by which a delay has to exceed a sample before a late drive is supposed."""
LOST = 0.2
"""Unknown force behind the motors [N·m] from which on another structure is supposed beside every law."""

Say = Callable[[str], None]
Tell = Callable[[Supposed, float], None]
"""Given what is found so far, and the share of the search that lies behind."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis with one cause more."""

    cause: str
    spot: Spot
    found: Supposed
    base: Supposed
    """The hypothesis without it."""
    placed: PlacedLaw | None = None
    """The law, where it is one."""

    @property
    def fall(self) -> float:
        """Fall of −2 ln L."""
        return self.base.total - self.found.total


def role_falls(before: Supposed, after: Supposed) -> tuple[float, float]:
    """Falls on the records fitted and on those kept out."""
    return before.total - after.total, before.kept_total - after.kept_total


def pays(fitted: float, kept: float, price: float = PRICE) -> bool:
    """Return whether falls on the records fitted and kept out pay a price."""
    share = price / PRICE
    return fitted + kept > price and fitted > share * LEAST_FITTED and kept > share * LEAST_KEPT


def is_sound(found: Supposed) -> bool:
    """Return whether every gap lies within its spring's motion and takes away that spring's own stiffness.

    Of a spring that no record bends nothing is known, so no gap in it either.
    """
    plant = found.numbers.plant
    names = [c.name for c in found.fit.problem.columns]
    springs = plant.of_kind(Kind.SPRING)
    deviation = np.sqrt(np.diag(found.fit.covariance))[plant.structure.index(Kind.SPRING)]
    for placed in found.hypothesis.laws:
        if not isinstance(placed.law, Backlash):
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


def try_law(now: Supposed, placed: PlacedLaw) -> Supposed:
    """The hypothesis with one law more, its shape and all numbers at their best."""
    found = now.refit(replace(now.hypothesis, laws=(*now.hypothesis.laws, placed)), iterations=5)
    for _ in range(2):
        found = reshape(found, 2)
        found = found.renewed(5) if placed.spot.where is not Where.MOTOR else found
    return found


def settle(now: Supposed, rounds: int = 5) -> Supposed:
    """Inner motion, shapes and numbers in turn until the value stands."""
    for _ in range(rounds):
        moved = reshape(
            now.renewed() if any(p.spot.where is not Where.MOTOR for p in now.hypothesis.laws) else now
        )
        gained = now.total - moved.total
        if gained > 0:
            now = moved
        if gained < 4.0:
            break
    return now


def try_channels(now: Supposed) -> list[Trial]:
    """Drives whose torque acts late by more than a sample, or lags, each against no such thing."""
    out = []
    timing, motors = now.numbers.timing, now.hypothesis.structure.motors
    deviation = np.sqrt(np.diag(now.fit.covariance))[now.numbers.plant.x.size :]
    for axis in range(motors):
        if any(a == axis for _, a in now.hypothesis.channels):
            continue
        spot = Spot(Where.MOTOR, axis)
        late = max(
            (abs(timing.delay[part, axis] - EXPECTED_DELAY[part]) - 1.0)
            / max(deviation[part * motors + axis], 1e-9)
            for part in (0, 1)
        )
        if late < SURELY_LATE:
            continue
        without = now.refit(
            replace(now.hypothesis, absent=now.hypothesis.absent | {(Channel.DELAY, axis)}), iterations=15
        )
        for channel in Channel:
            found = now.refit(
                replace(now.hypothesis, channels=now.hypothesis.channels | {(channel, axis)}), iterations=15
            )
            if channel is Channel.LAG:
                found = found.refit(
                    replace(found.hypothesis, absent=found.hypothesis.absent | {(Channel.DELAY, axis)}),
                    iterations=15,
                )
            out.append(Trial(channel.value, spot, found, without))
    return out


def try_modes(now: Supposed) -> list[Trial]:
    """One more mass behind each load on whose axis something unknown acts behind the motor."""
    out = []
    top = 2 * np.pi * now.bench.stacks[0].records[0].top_hz
    structure = now.hypothesis.structure
    shaken = _axes_with_force(now)
    for branch in range(structure.motors):
        if branch in structure.modes or structure.sizes[branch] < 2 or branch not in shaken:
            continue
        pool = [with_mode(now, branch, share, band * top) for share in MODE_SHARES for band in MODE_BANDS]
        starts = []
        for hypothesis, numbers in pool:
            with suppress(np.linalg.LinAlgError):
                starts.append(restructured(now, hypothesis, numbers, 0))
        starts = sorted(starts, key=lambda f: f.total)[:MODE_STARTS]
        found = sorted((f.refit(iterations=6) for f in starts), key=lambda f: f.total)
        if not found:
            continue
        best = found[0].refit(iterations=25)
        if mode_is_real(best, branch, top):
            out.append(Trial("extra_mode", Spot(Where.MOTOR, branch), best, now))
    return out


def _axes_with_force(now: Supposed) -> set[int]:
    """Axes that have an unknown force behind the motor of a tenth of the strongest, or more."""
    structure = now.hypothesis.structure
    least = 0.1 * now.inner_strength
    out: set[int] = set()
    for rms, spot in now.strength:
        if rms < least or spot.where is Where.MOTOR:
            continue
        if spot.where is Where.PAIR:
            out |= {spot.number, spot.other}
        else:
            out.add(
                structure.axis_of(
                    structure.links[spot.number][0] if spot.where is Where.SPRING else spot.number
                )
            )
    return out


def with_mode(now: Supposed, branch: int, share: float, frequency: float) -> tuple[Hypothesis, Numbers]:
    """A hypothesis with a share of a chain's load behind one more spring that alone swings at
    ``frequency``."""
    structure, plant = now.hypothesis.structure, now.numbers.plant
    wider = Structure(structure.sizes, (*structure.modes, branch))
    load = structure.load[branch]
    mass, spring, damper = (plant.of_kind(k) for k in (Kind.MASS, Kind.SPRING, Kind.DAMPER))
    whole = mass[load]
    masses = np.append(mass, whole * share)
    masses[load] = whole * (1 - share)
    stiffness = frequency**2 * whole * share * (1 - share)
    values = np.concatenate(
        (
            masses,
            np.append(spring, stiffness),
            np.append(damper, 0.02 * stiffness / frequency),
            plant.of_kind(Kind.COUPLING),
            plant.of_kind(Kind.LOAD_SPRING),
        )
    )
    numbers = replace(now.numbers, plant=Plant.of_values(wider, values))
    return replace(now.hypothesis, structure=wider), numbers


def restructured(now: Supposed, hypothesis: Hypothesis, numbers: Numbers, iterations: int) -> Supposed:
    """The fit of another structure; its inner motion is that of the places both have."""
    return now.in_structure(hypothesis.structure).refit(
        hypothesis, carry_over(numbers, now.fit.problem.spots), iterations
    )


def mode_is_real(found: Supposed, branch: int, top: float) -> bool:
    """Return whether a mode's mass and frequency are within what records can show."""
    plant = found.numbers.plant
    structure = plant.structure
    at = sum(structure.sizes) + structure.modes.index(branch)
    mass = plant.of_kind(Kind.MASS)
    spring = plant.of_kind(Kind.SPRING)[
        len(structure.links) - len(structure.modes) + structure.modes.index(branch)
    ]
    chain = mass[structure.motor[branch] : structure.load[branch] + 1].sum()
    return bool(
        MODE_MASS[0] < mass[at] / chain < MODE_MASS[1]
        and MODE_BAND[0] < np.sqrt(spring / mass[at]) / top < MODE_BAND[1]
    )


@dataclass(frozen=True, eq=False)
class Pursued:
    """Where a search ended, and the rivals of each cause that it took on the way."""

    end: Supposed
    rivals: tuple[tuple[Trial, Trial], ...]
    """Taken, and beside it what did nearly as well."""


NEARLY_AS_WELL = 0.15
"""Share of the fall of the cause taken that a rival may miss and is looked at again at the end."""


def pursue(
    now: Supposed,
    laws: Sequence[SupposedLaw] = SUPPOSED,
    say: Say = lambda _: None,
    tell: Tell = lambda _, __: None,
    rounds: int = 8,
) -> Pursued:
    """Causes taken one after another, each the one that lowers −2 ln L most, until none pays its price."""
    rivals: list[tuple[Trial, Trial]] = []
    now = reshape(scan_friction(now))
    say(f"null {now.total:.1f} inner {now.inner_strength:.2f}")
    for number in range(rounds):
        tell(now, number / rounds)
        if budget.is_left_out("further causes"):
            break
        now = now.renewed(3)
        looked = candidates(now, laws)
        falls = score(now, looked)
        trials: list[Trial] = []
        tried: set[tuple[str, Spot]] = set()
        for k in np.argsort(-falls):
            placed = looked[int(k)]
            if falls[k] < 6.0 or len(tried) >= REFINED:
                break
            if placed.key in tried or budget.is_left_out("further causes"):
                continue
            tried.add(placed.key)
            found = try_law(now, placed)
            if is_sound(found):
                trials.append(Trial(placed.law.cause, placed.spot, found, now, placed))
        best = max((t.fall for t in trials), default=0.0)
        if best < 2000.0 or now.inner_strength > LOST:
            trials += try_modes(now)
        trials += try_channels(now)
        trials.sort(key=lambda t: -t.fall)
        say("  " + ", ".join(f"{t.cause} {t.spot.where.value} {t.spot.number} {t.fall:.0f}" for t in trials))
        taken = next((t for t in trials if pays(*role_falls(t.base, t.found))), None)
        if taken is None:
            break
        close = taken.fall - max(NEARLY_AS_WELL * taken.fall, LEAST_FITTED)
        rivals += [(taken, t) for t in trials if t is not taken and t.fall > close]
        now = settle(reshape(scan_friction(taken.found)))
        say(f"  took {taken.cause} {taken.spot}: {now.total:.1f} inner {now.inner_strength:.2f}")
    return Pursued(now, tuple(rivals))
