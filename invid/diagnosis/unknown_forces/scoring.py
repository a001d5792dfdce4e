"""Scores of laws: by how much −2 ln L would fall with a law, everything else moving with it to first
order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.supposed_laws import SupposedLaw
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.plant import Structure
from invid.likelihood.unknown_forces.shapes import joint_rows
from invid.likelihood.unknown_forces.slope import whitened_rows
from invid.likelihood.unknown_forces.supposition import PlacedLaw, Supposed, vector_of
from invid.likelihood.unknown_forces.value import along
from invid.numerics.arrays import Float64

COARSE = 4
"""Instants that are one step of the grid of time for laws without corners."""
ALIKE = 1e-6
"""Share of a law that nothing else in the fit explains, below which it is none of its own."""


def spots_of(law: SupposedLaw, structure: Structure) -> list[Spot]:
    """Where a law may stand."""
    if law.at == "motor":
        return [Spot(Where.MOTOR, i) for i in range(structure.motors)]
    if law.at == "spring":
        return [Spot(Where.SPRING, k) for k in range(len(structure.links))]
    if law.at == "load":
        return [
            Spot(Where.MOTOR, i) if a == structure.motor[i] else Spot(Where.MASS, a)
            for i, a in enumerate(structure.tip)
        ]
    return [Spot(Where.MASS, a) for a in structure.inner]


def candidates(now: Supposed, laws: Sequence[SupposedLaw]) -> list[PlacedLaw]:
    """All laws at all places and shapes that do not stand yet."""
    taken = {p.key for p in now.hypothesis.laws}
    return [
        PlacedLaw(law, spot, shape)
        for law in laws
        if law.least_axes <= now.hypothesis.structure.motors
        for spot in spots_of(law, now.hypothesis.structure)
        if law.several or (law.cause, spot) not in taken
        for shape in law.shapes(now.motions.flat(spot))
    ]


def score(now: Supposed, laws: Sequence[PlacedLaw]) -> Float64:
    """(k,) falls of −2 ln L by each law with strengths as they are."""
    value = now.fit.value
    base = [joint_rows(now, k) for k in range(len(value.work))]
    joint = now.fit.slope.joint
    size = np.sqrt(np.diag(joint)) + 1e-300
    inverse = np.linalg.inv(joint / size[:, None] / size + 1e-10 * np.eye(size.size))
    left = [(w.missing + w.laws @ value.coefficients).ravel() for w in value.work]
    out = []
    for placed in laws:
        every = COARSE if placed.law.coarse else 1
        lines = now.bench.law_lines(placed, now.motions, every=every)
        vector = vector_of(now.hypothesis.structure, placed.spot)[:, None]
        count = lines[0].shape[2]
        own, cross, pull = np.zeros((count, count)), np.zeros((size.size, count)), np.zeros(count)
        for work, rows, rest, wave in zip(value.work, base, left, lines, strict=True):
            reach = along(work.condensed.motion, vector)
            flat = whitened_rows(work, wave[:, :, None] * reach).reshape(-1, count)
            own += flat.T @ flat
            cross += rows.T @ flat
            pull += flat.T @ rest
        cross = cross / size[:, None]
        unit = np.sqrt(np.diag(own)) + 1e-300
        rest_own = (own - cross.T @ inverse @ cross) / unit[:, None] / unit
        pull = pull / unit
        out.append(float(pull @ np.linalg.solve(rest_own + ALIKE * np.eye(count), pull)))
    return np.array(out)
