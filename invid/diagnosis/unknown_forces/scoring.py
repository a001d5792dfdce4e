"""Scores of laws: by how much −2 ln L would fall with a law, everything else moving with it to first
order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.effects.effect import Effect
from invid.effects.supposed_laws import SupposedLaw
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.plant import Structure
from invid.likelihood.unknown_forces.shapes import joint_rows
from invid.likelihood.unknown_forces.slope import whitened_rows
from invid.likelihood.unknown_forces.supposition import PlacedLaw, Supposed, axis_of, vector_of
from invid.likelihood.unknown_forces.value import along
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64

ALIKE = 1e-4
"""Share of a law's power that nothing else in the fit explains, below which it is none of its own: motion is
known to a thousandth, so a hundredth of a law's size (its square) is the least that is not made of that."""


def spots_of(law: SupposedLaw, structure: Structure) -> list[Spot]:
    """Where a law may stand."""
    axes = tuple(str(i) for i in range(structure.motors))
    return [spot_at(structure, place) for place in law.places(ChainStructure(structure.sizes, axes))]


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


def look_alikes(now: Supposed, cause: Effect, spot: Spot, laws: Sequence[SupposedLaw]) -> list[PlacedLaw]:
    """Laws on the axis of ``spot`` for which a cause there is easily mistaken, at all shapes.

    ``now`` is the hypothesis without the cause. The same cause elsewhere on the axis is one of them.
    """
    structure = now.hypothesis.structure
    alike = [
        law
        for law in laws
        if law.cause == cause.cause or law.cause in cause.looks_like or cause.cause in law.effect.looks_like
    ]
    return [
        p
        for p in candidates(now, alike)
        if axis_of(structure, p.spot) == axis_of(structure, spot)
        and (p.law.cause, p.spot) != (cause.cause, spot)
    ]


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
        if budget.is_left_out("further causes"):
            out.append(0.0)
            continue
        lines = now.bench.law_lines(placed, now.motions, quick=True)
        vector = vector_of(now.hypothesis.structure, placed.spot)[:, None]
        columns = []
        for work, wave in zip(now.fit.value.work, lines, strict=True):
            if placed.law.scales:
                torque = -now.numbers.timing.acting(work.stack)[:, :, placed.spot.number]
                rows = torque[..., None, None] * np.eye(work.shape[2])[placed.spot.number][:, None]
            elif placed.law.reads:
                rows = wave[:, :, None] * work.condensed.stiffness[:, :, placed.spot.number, None]
            else:
                rows = wave[:, :, None] * along(work.condensed.motion, vector)
            columns.append(whitened_rows(work, rows).reshape(-1, wave.shape[2]))
        own, pull = background.beside(columns)
        out.append(bounded_fall(own, pull, placed.law.limits(now.motions.flat(placed.spot))))
    return np.array(out)


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
    """Largest −2·pull·β − βᵀ·own·β with β within its limits: one at a time the worst violator is put at
    its bound."""
    low, high = np.array(limits).T
    beta, free = np.zeros(pull.size), np.ones(pull.size, dtype=bool)
    while free.any():
        beta[free] = -solve_scaled(
            own[np.ix_(free, free)], pull[free] + own[np.ix_(free, ~free)] @ beta[~free]
        )
        bound = np.clip(beta, low, high)
        beyond = np.abs(beta - bound) * np.sqrt(np.diag(own))
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0.0:
            break
        beta[worst], free[worst] = bound[worst], False
    return float(-2.0 * pull @ beta - beta @ own @ beta)


def solve_scaled(own: Float64, pull: Float64) -> Float64:
    """Solution of a positive system whose unknowns have units of their own."""
    unit = np.sqrt(np.diag(own)) + 1e-300
    out: Float64 = np.linalg.solve(own / unit[:, None] / unit, pull / unit) / unit
    return out
