"""Scores of laws: by how much −2 ln L would fall with a law, everything else moving with it to first
order."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.diagnosis.unknown_forces.projected_rows import law_rows
from invid.effects.supposed.law import SupposedLaw
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.shapes import joint_rows
from invid.likelihood.unknown_forces.supposition import Supposed
from invid.likelihood.unknown_forces.value import bounded_minimum
from invid.model.place import Place
from invid.model.plant import Structure
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.wording.sentence import sentence

ALIKE = 1e-4
"""Share of a law's power that nothing else in the fit explains, below which it is none of its own: motion is
known to a thousandth, so a hundredth of a law's size (its square) is the least that is not made of that."""


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


def candidates(now: Supposed, laws: Sequence[SupposedLaw]) -> list[PlacedLaw]:
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


@dataclass(frozen=True, eq=False)
class Background:
    """What else a fit moves: by how much −2 ln L falls with columns beside it, all else moving to first
    order."""

    rows: tuple[Float64, ...]
    """(rows, p + J') of each stack."""
    left: tuple[Float64, ...]
    """(rows,) missing torque of each stack."""
    size: Float64
    inverse: Float64

    @classmethod
    def of(cls, now: Supposed) -> Background:
        """At a fit, with strengths as they are."""
        value, joint = now.fit.value, now.fit.slope.joint
        size: Float64 = np.sqrt(np.diag(joint)) + 1e-300
        inverse = np.asarray(
            np.linalg.inv(joint / size[:, None] / size + 1e-10 * np.eye(size.size)), dtype=np.float64
        )
        return cls(
            tuple(joint_rows(now, k) for k in range(len(value.work))),
            tuple((w.missing + w.laws @ value.coefficients).ravel() for w in value.work),
            size,
            inverse,
        )

    def beside(self, columns: Sequence[Float64]) -> tuple[Float64, Float64]:
        """(k, k) and (k,): what of whitened columns (rows, k) of each stack nothing else explains, and their
        pull."""
        count = columns[0].shape[1]
        own, cross, pull = np.zeros((count, count)), np.zeros((self.size.size, count)), np.zeros(count)
        for rows, rest, flat in zip(self.rows, self.left, columns, strict=True):
            own += flat.T @ flat
            cross += rows.T @ flat
            pull += flat.T @ rest
        cross = cross / self.size[:, None]
        return own - cross.T @ self.inverse @ cross + ALIKE * np.diag(np.diag(own) + 1e-300), pull


def score(now: Supposed, laws: Sequence[PlacedLaw]) -> Float64:
    """(k,) falls of −2 ln L by each law with strengths as they are; zero of what a budget leaves out."""
    background = Background.of(now)
    out = []
    for placed in laws:
        if budget.is_left_out(sentence("further causes")):
            out.append(0.0)
            continue
        own, pull = background.beside(law_rows(now, placed))
        out.append(bounded_fall(own, pull, placed.law.limits(now.motions.flat(placed.spot))))
    return np.array(out)


def column_fall(now: Supposed, name: Hashable) -> float:
    """The same by a motor's friction that is held at zero."""
    number = [c.name for c in now.fit.problem.columns].index(name)
    rows = [w.laws[..., number].reshape(-1, 1) for w in now.fit.value.work]
    low = -np.inf if isinstance(name, tuple) and name[0] is Part.OFFSET else 0.0
    return bounded_fall(*Background.of(now).beside(rows), [(low, np.inf)])


def own_share(found: Supposed, placed: PlacedLaw) -> float:
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


def bounded_fall(own: Float64, pull: Float64, limits: Sequence[tuple[float, float]]) -> float:
    """Largest −2·pull·β − βᵀ·own·β with β within its limits."""
    low, high = np.array(limits).T
    beta, _ = bounded_minimum(own, pull, (low, high))
    return float(-2.0 * pull @ beta - beta @ own @ beta)
