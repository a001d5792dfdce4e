"""What each cause is worth at the end: the rise of −2 ln L when it alone goes out and all else fits anew."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.diagnosis.unknown_forces.pursuit import PRICE, pays, role_falls
from invid.diagnosis.unknown_forces.structures import additions_of, without
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.plant import Kind
from invid.likelihood.unknown_forces.shapes import curvature, reshape
from invid.likelihood.unknown_forces.supposition import Channel, Supposed
from invid.numerics import budget

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
    it."""

    cause: str
    key: Hashable
    rise: float
    roles: tuple[float, float]

    @property
    def stays(self) -> bool:
        """Whether it pays its price."""
        if isinstance(self.key, tuple) and isinstance(self.key[0], Part):
            # Its strength left at a motor makes a fit without it less sure of the records kept out.
            return self.rise > PRICE_OF_FRICTION and sum(self.roles) > PRICE_OF_FRICTION
        return pays(*self.roles)


def worths(now: Supposed) -> list[Worth]:
    """The worth of every law, mode, load spring, constant torque and part of friction."""
    out = []
    for k, placed in enumerate(now.hypothesis.laws):
        fewer = replace(now.hypothesis, laws=(*now.hypothesis.laws[:k], *now.hypothesis.laws[k + 1 :]))
        out.append(_worth(now, placed.law.cause, placed.key, now.refit(fewer, iterations=10)))
    structure = now.hypothesis.structure
    springs = now.numbers.plant.of_kind(Kind.LOAD_SPRING)
    deviation = np.sqrt(np.diag(now.fit.covariance))[structure.index(Kind.LOAD_SPRING)]
    for k, pair in enumerate(structure.pairs):
        unit = now.numbers.plant.unit[structure.index(Kind.LOAD_SPRING)][k]
        if abs(springs[k]) > 4.0 * deviation[k] * unit:
            out.append(_worth(now, "coupling_stiffness", pair, _without(now, pair)))
    names = [c.name for c in now.fit.problem.columns]
    for motor in range(structure.motors):
        rest = now
        for part, cause in FRICTION:
            if rest.fit.value.coefficients[names.index((part, motor))]:
                gone = _without(rest, (part, motor))
                out.append(_worth(rest, cause, (part, motor), gone))
                # A rise may stand for all of dry friction: what goes out leaves its force to the others.
                rest = rest if out[-1].stays else gone
    for channel, axis in now.hypothesis.channels:
        absent = now.hypothesis.absent | {(Channel.DELAY, axis)}
        less = replace(now.hypothesis, channels=now.hypothesis.channels - {(channel, axis)}, absent=absent)
        out.append(_worth(now, channel.value, (channel, axis), now.refit(less, iterations=15)))
    out += [_worth(now, a.cause, a, without(now, a)) for a in additions_of(structure)]
    return out


def _worth(now: Supposed, cause: str, key: Hashable, less: Supposed) -> Worth:
    budget.check()  # a fit that was cut short tells nothing
    return Worth(cause, key, less.total - now.total, role_falls(less, now))


def first_order_worths(now: Supposed) -> list[Worth]:
    """The worth of every cause by its coefficients over their deviations, without a fit (Wald)."""
    known = curvature(now)
    names = [c.name for c in now.fit.problem.columns]
    shares = np.array([1.0, 0.5])
    out = []

    def add(cause: str, key: Hashable, columns: Sequence[Hashable]) -> None:
        at = [k for k, c in enumerate(known.free) if names[c] in columns]
        if at:
            value = now.fit.value.coefficients[known.free[at]]
            index = known.numbers + np.array(at)
            rise = float(value @ np.linalg.solve(known.covariance[np.ix_(index, index)], value))
            out.append(Worth(cause, key, rise, (float(shares[0] * rise), float(shares[1] * rise))))

    for placed in now.hypothesis.laws:
        own = [(*placed.key, i) for i in range(len(placed.law.low))]
        add(placed.law.cause, placed.key, own)
    for motor in range(now.hypothesis.structure.motors):
        for part, cause in FRICTION:
            add(cause, (part, motor), [(part, motor)])
    sure = 2.0 * PRICE
    fixed: list[tuple[str, Hashable]] = [(c.value, (c, a)) for c, a in now.hypothesis.channels]
    fixed += [(a.cause, a) for a in additions_of(now.hypothesis.structure)]
    return [*out, *(Worth(cause, key, sure, (sure, sure)) for cause, key in fixed)]


def _without(now: Supposed, name: Hashable) -> Supposed:
    hypothesis = replace(now.hypothesis, absent=now.hypothesis.absent | {name})
    return reshape(now.refit(hypothesis, iterations=10), 1)
