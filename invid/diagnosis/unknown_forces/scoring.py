"""Scores of laws: by how much −2 ln L would fall with a law, everything else moving with it to first
order."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from invid.diagnosis.unknown_forces.projected_rows import law_rows, scale_rows
from invid.effects.supposed.law import SupposedLaw
from invid.likelihood.unknown_forces.background import Background, bounded_fall
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.place import Place
from invid.model.plant import Structure
from invid.numerics import budget
from invid.numerics.arrays import Float64

ANY = (-np.inf, np.inf)
"""Limits of a coefficient that has none."""


def spots_of(law: SupposedLaw, structure: Structure) -> list[Spot]:
    """Where a law may stand."""
    return [spot_at(structure, place) for place in law.places(Structure(structure.sizes))]


def spot_at(structure: Structure, place: Place) -> Spot:
    """The spot of a place of the chains."""
    if place.other >= 0:
        return Spot(Where.PAIR, place.axis, place.other)
    if place.kind == "spring":
        return Spot(Where.SPRING, sum(structure.sizes[: place.axis]) - place.axis + place.number - 1)
    if place.number > 1:
        return Spot(Where.MASS, structure.motor[place.axis] + place.number - 1)
    return Spot(Where.MOTOR, place.axis)


def candidates(now: FittedHypothesis, laws: Sequence[SupposedLaw]) -> list[PlacedLaw]:
    """All laws at all places and shapes that do not stand yet, nor within another."""
    standing: dict[Spot, list[PlacedLaw]] = {}
    for placed in now.hypothesis.laws:
        standing.setdefault(placed.spot, []).append(placed)
    out = []
    for law in laws:
        for spot in spots_of(law, now.hypothesis.structure):
            here = standing.get(spot, [])
            alike = [p for p in here if p.law.cause == law.cause]
            within = any(isinstance(law, p.law.contains) for p in here)
            if within or (alike and not law.several):
                continue
            number = 1 + max((p.number for p in alike), default=-1)
            shapes = law.shapes(now.motions.flat(spot))
            out += [PlacedLaw(law, spot, shape, number) for shape in shapes]
    return out


def score(now: FittedHypothesis, laws: Sequence[PlacedLaw]) -> Float64:
    """(k,) falls of −2 ln L by each law with strengths as they are; zero of what a budget leaves out."""
    background = Background.of(now)
    out = []
    for placed in laws:
        if budget.is_left_out(budget.FURTHER_CAUSES):
            out.append(0.0)
            continue
        limits = placed.law.limits(now.motions.flat(placed.spot))
        rows = law_rows(now, placed)
        fall = bounded_fall(*background.beside(rows), limits)
        if placed.law.reads:  # another scale of the reading is no part of what a law of it says
            scale = scale_rows(now, placed.spot)
            both = [np.concatenate(pair, axis=1) for pair in zip(rows, scale, strict=True)]
            beside = bounded_fall(*background.beside(both), [*limits, ANY])
            fall = min(fall, beside - bounded_fall(*background.beside(scale), [ANY]))
        out.append(fall)
    return np.array(out)


def column_fall(now: FittedHypothesis, name: Hashable) -> float:
    """The same by a motor's friction that is held at zero."""
    number = [c.name for c in now.fit.problem.columns].index(name)
    rows = [w.laws[..., number].reshape(-1, 1) for w in now.fit.value.work]
    low = -np.inf if isinstance(name, tuple) and name[0] is Part.OFFSET else 0.0
    return bounded_fall(*Background.of(now).beside(rows), [(low, np.inf)])


def own_share(found: FittedHypothesis, placed: PlacedLaw) -> float:
    """Share of a fitted law's power that nothing else in the fit explains, of its most independent part."""
    value, joint = found.fit.value, found.fit.slope.joint
    names, free = [c.name for c in found.fit.problem.columns], np.flatnonzero(value.free)
    size = np.sqrt(np.diag(joint)) + 1e-300
    spread = np.diag(np.linalg.pinv(joint / size[:, None] / size, hermitian=True))
    first = joint.shape[0] - free.size
    own = [
        first + k
        for k, j in enumerate(free)
        if names[j] in [(*placed.key, i) for i in range(len(placed.law.low))]
    ]
    return max((1.0 / float(spread[k]) for k in own), default=0.0)
