"""What a cause is worth: the fall of −2 ln L that it brings, its price, and the worth of motors' friction."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.unknown_forces.forces import Spot
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.shapes import Curvature, curvature, reshape
from invid.likelihood.unknown_forces.supposition import Supposed
from invid.numerics import budget

PRICE, LEAST_FITTED, LEAST_KEPT = 120.0, 40.0, 10.0
"""Fall of −2 ln L that a cause must bring on all records, on those fitted and on those kept out.

Schwarz's price of its numbers, and of the places and shapes looked at, is about 40; the rest is what the form
of friction and the grid of motion leave (empirical: false falls of up to 60 of −ln L in sixty rounds of whole
cells of another hand).
"""
NUMBER = 10.0
"""Schwarz's price of one number and ten thousand rows."""
PRICE_OF_FRICTION = 40.0
"""Rise of −2 ln L for a part of the friction of a motor, which is expected on every motor: Schwarz's price
of its two numbers and ten thousand rows is 20; the rest is what an encoder's rounding leaves, up to 31
(empirical, nothing hidden)."""


FRICTION = (
    (Part.OFFSET, "torque_offset"),
    (Part.RISE, "stribeck_friction"),
    (Part.VISCOUS, "viscous_friction"),
    (Part.DRY, "coulomb_friction"),
)
"""Parts of a motor's friction, and the causes that they are."""


@dataclass(frozen=True, eq=False)
class Worth:
    """A cause of the final hypothesis with the rise of −2 ln L on all records and on either role's without
    it, and the unknown force that is then left at every place [N·m]."""

    cause: str
    key: Hashable
    rise: float
    roles: tuple[float, float]
    left: tuple[tuple[float, Spot], ...] = ()
    numbers: int = 1
    """Numbers that it brings, of a law its first alone."""

    @property
    def is_friction(self) -> bool:
        """Whether it is a part of a motor's friction."""
        return isinstance(self.key, tuple) and isinstance(self.key[0], Part)

    @property
    def price(self) -> float:
        """Rise at which it is as likely as not."""
        return PRICE_OF_FRICTION if self.is_friction else price_of(self.numbers)

    @property
    def stays(self) -> bool:
        """Whether it pays its price."""
        if self.is_friction:
            # Its strength left at a motor makes a fit without it less sure of the records kept out.
            return self.rise > self.price and sum(self.roles) > self.price
        return pays(*self.roles, self.numbers)


def role_falls(before: Supposed, after: Supposed) -> tuple[float, float]:
    """Falls on the records fitted and on those kept out."""
    return before.total - after.total, before.kept_total - after.kept_total


def price_of(numbers: int, first: float = PRICE) -> float:
    """Fall that so many numbers must bring, ``first`` that of one."""
    return first + NUMBER * (numbers - 1)


def pays(fitted: float, kept: float, numbers: int = 1, first: float = PRICE) -> bool:
    """Return whether falls on the records fitted and kept out pay the price of so many numbers, ``first`` of
    one."""
    price = price_of(numbers, first)
    share = price / PRICE
    return fitted + kept > price and fitted > share * LEAST_FITTED and kept > share * LEAST_KEPT


def worth_of(now: Supposed, cause: str, key: Hashable, less: Supposed) -> Worth:
    budget.check()  # a fit that was cut short tells nothing
    return Worth(cause, key, less.total - now.total, role_falls(less, now), tuple(less.strength))


def friction_worths(now: Supposed, clear: float = np.inf) -> list[Worth]:
    """The worth of every part of the friction of motors, one after another: what goes out leaves its force to
    the others.

    Nothing is fitted where the rise to first order is ``clear`` times the price and more, or so much less.
    """
    out: list[Worth] = []
    names = [c.name for c in now.fit.problem.columns]
    for motor in range(now.hypothesis.structure.motors):
        rest = now
        for part, cause in FRICTION:
            key = (part, motor)
            if not rest.fit.value.coefficients[names.index(key)]:
                continue
            rise = 0.0 if np.isinf(clear) else first_order_rise(curvature(rest), rest, [key])
            if rise > clear * PRICE_OF_FRICTION:
                out.append(Worth(cause, key, rise, (rise, 0.0)))
                continue
            if 0.0 < rise < PRICE_OF_FRICTION / clear:
                out.append(Worth(cause, key, rise, (rise, 0.0)))
                absent = rest.hypothesis.absent | {key}
                rest = rest.refit(replace(rest.hypothesis, absent=absent), iterations=0)
                continue
            gone = without_column(rest, key)
            out.append(worth_of(rest, cause, key, gone))
            # A rise may stand for all of dry friction.
            rest = rest if out[-1].stays else gone
    return out


def first_order_rise(known: Curvature, now: Supposed, columns: Sequence[Hashable]) -> float:
    """Rise of −2 ln L without some columns, by their coefficients over their deviations (Wald); 0 where they
    are at their bounds."""
    names = [c.name for c in now.fit.problem.columns]
    at = [k for k, c in enumerate(known.free) if names[c] in columns]
    if not at:
        return 0.0
    value = now.fit.value.coefficients[known.free[at]]
    index = known.numbers + np.array(at)
    return float(value @ np.linalg.solve(known.covariance[np.ix_(index, index)], value))


def gone_columns(worths: Sequence[Worth]) -> frozenset[Hashable]:
    """Parts of motors' friction that do not pay.

    Dry friction stays where its rise at slow speed does: a rise is one above it.
    """
    columns = {w.key: w.stays for w in worths if isinstance(w.key, tuple) and w.is_friction}
    gone = {key for key, stays in columns.items() if not stays}
    return frozenset(key for key in gone if key[0] is not Part.DRY or not columns.get((Part.RISE, key[1])))


def without_column(now: Supposed, name: Hashable) -> Supposed:
    """The fit with a column, or a spring between two loads, held at zero."""
    hypothesis = replace(now.hypothesis, absent=now.hypothesis.absent | {name})
    return reshape(now.refit(hypothesis, iterations=10), 1)
