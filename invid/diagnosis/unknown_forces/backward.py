"""What each cause is worth at the end: the rise of −2 ln L when it alone goes out and all else fits anew."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.unknown_forces.structures import additions_of, without
from invid.likelihood.unknown_forces.shapes import curvature
from invid.likelihood.unknown_forces.supposition import Channel, Supposed
from invid.likelihood.unknown_forces.worth import (
    FRICTION,
    PRICE,
    Worth,
    first_order_rise,
    friction_worths,
    without_column,
    worth_of,
)
from invid.model.plant import Kind


def worths(now: Supposed) -> list[Worth]:
    """The worth of every law, mode, load spring, constant torque and part of friction."""
    out = []
    for k, placed in enumerate(now.hypothesis.laws):
        fewer = replace(now.hypothesis, laws=(*now.hypothesis.laws[:k], *now.hypothesis.laws[k + 1 :]))
        out.append(worth_of(now, placed.law.cause, placed.key, now.refit(fewer, iterations=10)))
    structure = now.hypothesis.structure
    springs = now.numbers.plant.of_kind(Kind.LOAD_SPRING)
    deviation = np.sqrt(np.diag(now.fit.covariance))[structure.index(Kind.LOAD_SPRING)]
    for k, pair in enumerate(structure.pairs):
        unit = now.numbers.plant.unit[structure.index(Kind.LOAD_SPRING)][k]
        if abs(springs[k]) > 4.0 * deviation[k] * unit:
            out.append(worth_of(now, "coupling_stiffness", pair, without_column(now, pair)))
    out += friction_worths(now)
    for channel, axis in now.hypothesis.channels:
        absent = now.hypothesis.absent | {(Channel.DELAY, axis)}
        less = replace(now.hypothesis, channels=now.hypothesis.channels - {(channel, axis)}, absent=absent)
        out.append(worth_of(now, channel.value, (channel, axis), now.refit(less, iterations=15)))
    for a in additions_of(structure):
        out.append(replace(worth_of(now, a.cause, a, without(now, a)), numbers=a.numbers(structure)))
    return out


def first_order_worths(now: Supposed) -> list[Worth]:
    """The worth of every cause by its coefficients over their deviations, without a fit (Wald)."""
    known, out = curvature(now), list[Worth]()

    def add(cause: str, key: Hashable, columns: Sequence[Hashable]) -> None:
        rise = first_order_rise(known, now, columns)
        if rise:
            out.append(Worth(cause, key, rise, (rise, 0.5 * rise)))

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
