"""What a cause is worth: the fall of −2 ln L that it brings, its price, and the worth of motors' friction."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from invid.likelihood.unknown_forces.descent import Ended
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import FITTED, NUMBER, PARTS, pays, price, price_at_motors
from invid.likelihood.unknown_forces.shapes import reshape
from invid.model.plant import Kind
from invid.numerics import budget
from invid.wording.sentence import sentence

WEIGHING = sentence("what each cause is worth")
"""What a spent budget leaves out, in the words of the warning."""
LOOSE = 4.0
"""Deviations from which on a spring between two loads is weighed by itself."""
AGREED = 3
"""Most times that motion is made to agree with the friction that is left."""
FRICTION = (
    (Part.OFFSET, "torque_offset"),
    (Part.RISE, "stribeck_friction"),
    (Part.VISCOUS, "viscous_friction"),
    (Part.DRY, "coulomb_friction"),
)
"""Parts of a motor's friction, and the causes that they are."""


@dataclass(frozen=True, eq=False)
class Worth:
    """A cause of a hypothesis with the rise of −2 ln L on all records and on either role's without it, and
    the unknown force that is then left at every place [N·m]."""

    cause: str
    key: Hashable
    rise: float = 0.0
    roles: tuple[float, float] = (0.0, 0.0)
    left: tuple[tuple[float, Spot], ...] = ()
    numbers: int = 1
    """Numbers that it brings, of a law its first alone."""
    gaps: tuple[float, float] | None = (0.0, 0.0)
    """By how much the value with it, and that without, may still fall; ``None``: it was not weighed."""

    @property
    def is_friction(self) -> bool:
        """Whether it is a part of a motor's friction."""
        return isinstance(self.key, tuple) and isinstance(self.key[0], Part)

    @property
    def price(self) -> float:
        """Rise at which it is as likely as not."""
        return price_at_motors(PARTS) if self.is_friction else price(self.numbers)

    @property
    def is_weighed(self) -> bool:
        """Whether it is known to pay its price or not, however far its fits may still fall."""
        if self.gaps is None:
            return False
        with_it, without = self.gaps
        return self._pays(-without) == self._pays(with_it)

    @property
    def stays(self) -> bool:
        """Whether it pays its price; what is not weighed is not known not to."""
        return self._pays(0.0) or not self.is_weighed

    @property
    def may_pay(self) -> bool:
        """Whether what it brings on the records fitted is enough to ask for the records kept out."""
        least = self.price if self.is_friction else FITTED * self.price
        return self.rise + sum(self.gaps or ()) > least

    def _pays(self, more: float) -> bool:
        fitted, kept = self.roles
        if self.is_friction:
            # Its strength left at a motor makes a fit without it less sure of the records kept out.
            return self.rise + more > self.price and fitted + more + kept > self.price
        return pays(fitted + more, kept, self.price)


def role_falls(before: FittedHypothesis, after: FittedHypothesis) -> tuple[float, float]:
    """Falls on the records fitted and on those kept out."""
    return before.total - after.total, before.kept_total - after.kept_total


@dataclass(frozen=True, eq=False)
class Deletion:
    """A cause that a hypothesis has, and the fit without it."""

    cause: str
    key: Hashable
    without: Callable[[FittedHypothesis], FittedHypothesis]
    numbers: int = 1


def _weigh(now: FittedHypothesis, one: Deletion) -> tuple[Worth, FittedHypothesis | None]:
    """What a cause is worth, and the fit without it; unweighed where the time is up."""
    if budget.is_left_out(WEIGHING):
        return Worth(one.cause, one.key, numbers=one.numbers, gaps=None), None
    less = one.without(now)
    gaps, rise = (now.fit.open_gap, less.fit.open_gap), less.total - now.total
    worth = Worth(one.cause, one.key, rise, (rise, 0.0), tuple(less.strength), one.numbers, gaps)
    if worth.may_pay and less.motions is now.motions:
        worth = replace(worth, roles=(rise, less.kept_total_unmoved - now.kept_total_unmoved))
    elif worth.may_pay:
        worth = replace(worth, roles=role_falls(less, now))
    return (replace(worth, gaps=None) if less.fit.ended is Ended.CUT else worth), less


def prune(
    now: FittedHypothesis,
    deletions_of: Callable[[FittedHypothesis], Sequence[Deletion]],
    kept: Collection[Hashable] = (),
) -> tuple[tuple[Worth, ...], FittedHypothesis]:
    """What each cause is worth in the fit with those that pay, and that fit.

    One at a time the one that is least above its price goes, once it is known to be poor beside those left:
    two that are each dispensable beside the other do not both go. Those ``kept`` stay in the fit.
    """
    known: dict[Hashable, tuple[Worth, FittedHypothesis | None]] = {}
    weighed_at: dict[Hashable, FittedHypothesis] = {}
    now = now.at_rest_on_kept()
    while True:
        deletions = {d.key: d for d in deletions_of(now)}
        for key, deletion in deletions.items():
            if key not in known:
                known[key], weighed_at[key] = _weigh(now, deletion), now
        lower = _lower(now, [known[key][1] for key in deletions])
        if lower is not None:
            now, known = lower.at_rest_on_kept(), {}
            continue
        worths = [known[key][0] for key in deletions]
        stays = {w.key for w in worths if w.stays}
        # A rise at slow speed is one above dry friction: it goes first, or would stand for that.
        needed = {(Part.DRY, motor) for motor in range(now.hypothesis.structure.motors)}
        needed = {(part, motor) for part, motor in needed if (Part.RISE, motor) in deletions}
        poor = [w for w in worths if w.key not in stays | needed | {*kept}]
        if not poor:
            return tuple(worths), now
        least = min(poor, key=lambda w: w.rise - w.price).key
        if weighed_at[least] is not now:
            known[least], weighed_at[least] = _weigh(now, deletions[least]), now
        else:
            now = known[least][1] or now


def _lower(now: FittedHypothesis, parts: Sequence[FittedHypothesis | None]) -> FittedHypothesis | None:
    """A lower fit of the same hypothesis, where a part of it does better than the whole: that was at no least
    value."""
    hypothesis = now.hypothesis
    alike = [p for p in parts if p is not None and p.hypothesis.structure == hypothesis.structure]
    best = min(alike, key=lambda p: p.total, default=now)
    if not best.total < now.total - NUMBER:
        return None
    whole = replace(
        best.hypothesis, laws=hypothesis.laws, absent=hypothesis.absent, channels=hypothesis.channels
    )
    found = reshape(best.refit(whole), 1)
    return found if found.total < now.total - NUMBER else None


def friction_deletions(now: FittedHypothesis) -> list[Deletion]:
    """The parts of the friction of motors that are not at zero."""
    sizes = now.sizes
    return [
        Deletion(cause, (part, motor), partial(_without_friction, part=part, motor=motor))
        for motor in range(now.hypothesis.structure.motors)
        for part, cause in FRICTION
        if sizes[part, motor]
    ]


def channel_deletions(now: FittedHypothesis) -> list[Deletion]:
    """The drives that are late or lag."""
    return [
        Deletion(channel.value, (channel, axis), partial(_without_channel, own=(channel, axis)))
        for channel, axis in sorted(now.hypothesis.channels, key=lambda c: (c[1], c[0].value))
    ]


def spring_deletions(now: FittedHypothesis) -> list[Deletion]:
    """The springs between loads."""
    return [
        Deletion("coupling_stiffness", pair, partial(without_column, name=pair))
        for pair in now.hypothesis.structure.pairs
        if pair not in now.hypothesis.absent
    ]


def without_loose_springs(now: FittedHypothesis) -> FittedHypothesis:
    """The fit without all springs between loads that are none of four deviations, where together they pay no
    price: six axes have fifteen of them."""
    structure = now.hypothesis.structure
    index = structure.index(Kind.LOAD_SPRING)
    size = np.abs(now.numbers.plant.x[index]) / np.sqrt(np.diag(now.fit.covariance))[index]
    loose = {p for p, s in zip(structure.pairs, size, strict=True) if s < LOOSE} - now.hypothesis.absent
    if not loose or budget.is_left_out(WEIGHING):
        return now
    less = now.refit(replace(now.hypothesis, absent=now.hypothesis.absent | loose))
    return less if less.fit.is_finished and less.total - now.total < price() else now


def _without_channel(now: FittedHypothesis, own: tuple[Channel, int]) -> FittedHypothesis:
    absent = now.hypothesis.absent | {(Channel.DELAY, own[1])}
    return now.refit(replace(now.hypothesis, channels=now.hypothesis.channels - {own}, absent=absent))


def _without_friction(now: FittedHypothesis, part: Part, motor: int) -> FittedHypothesis:
    """The fit without a part of a motor's friction; where a rise at slow speed seems to pay, on motion that
    agrees with the rest as that before agreed with it."""
    less = without_column(now, (part, motor))
    for _ in range(AGREED if part is Part.RISE else 0):
        if less.total - now.total < price_at_motors(PARTS):
            break
        less = min(less, reshape(less.with_agreed_motors(), 1), key=lambda f: f.total)
    return less


def without_column(now: FittedHypothesis, name: Hashable) -> FittedHypothesis:
    """The fit with a column, or a spring between two loads, held at zero."""
    hypothesis = replace(now.hypothesis, absent=now.hypothesis.absent | {name})
    return reshape(now.refit(hypothesis), 1)
