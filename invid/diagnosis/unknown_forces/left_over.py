"""What is left: the unknown force at every place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.effects.units import unit_of
from invid.identification.quantities import axis_and_element
from invid.likelihood.unknown_forces.descent import Fit, fit
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.likelihood.unknown_forces.motions import axis_of
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import PLACES, price_at_motors
from invid.likelihood.unknown_forces.worth import Worth
from invid.model.diagnosis_document import ForceAt
from invid.model.plant import Structure
from invid.numerics import budget
from invid.recording.model import Recording

SURE = price_at_motors(PLACES)
"""Rise of −2 ln L without a strength from which something acts at its place."""

IMPERFECT = 0.03
"""Share of what acts at a place that a named cause may leave there since its law is not quite the machine's
(empirical: friction at reversals in chains of another integrator leaves a sixtieth)."""
MOST = 4
"""Strongest places of unknown forces that are weighed."""


@dataclass(frozen=True, eq=False)
class PlaceForce:
    """Unknown force at a place [N·m rms], the rise of −2 ln L without it (where sure, at most so much), the
    force there without causes."""

    spot: Spot
    rms: float
    rise: float
    before: float

    @property
    def is_sure(self) -> bool:
        """Whether something acts there that is not the imperfect shape of what is named."""
        return self.rise > SURE and self.rms > IMPERFECT * self.before


def is_of_shapes(worth: Worth, end: FittedHypothesis, bare: FittedHypothesis) -> bool:
    """Whether what a cause takes is no more, on any axis, than what the laws of the others may leave there
    since they are not quite the machine's. Friction is expected on every motor, and never such.

    ``bare``: the plant without causes.
    """
    if isinstance(worth.key, tuple) and isinstance(worth.key[0], Part):
        return False
    structure = bare.hypothesis.structure
    before, after = ({s: rms for rms, s in found.strength} for found in (bare, end))
    acts, taken = np.zeros(structure.motors), np.zeros(structure.motors)
    for rms, spot in worth.left:
        if spot in before:
            axes = {axis_of(structure, spot), *({spot.other} if spot.where is Where.PAIR else ())}
            for axis in axes:
                acts[axis] = max(acts[axis], before[spot])
                taken[axis] = max(taken[axis], rms**2 - after.get(spot, 0.0) ** 2)
    return bool(worth.left) and bool((taken <= (IMPERFECT * acts) ** 2).all())


def _closed(found: FittedHypothesis, spot: Spot) -> Fit:
    """The fit with no unknown force at a place, given up where something is sure to act there."""
    problem = found.fit.problem
    number = problem.spots.number[spot]
    strength = found.numbers.strength.copy()
    strength[number] = problem.least
    closed = replace(problem, shut=np.array([*problem.shut, number]))
    without = fit(closed, replace(found.numbers, strength=strength), target=found.total + SURE)
    budget.check()
    return without


def place_forces(found: FittedHypothesis, bare: FittedHypothesis) -> tuple[PlaceForce, ...]:
    """The strongest unknown forces, each with what its absence costs; BudgetSpent where none is told.

    ``bare``: the plant without causes.
    """
    before = {s: rms for rms, s in bare.strength}
    return tuple(
        PlaceForce(s, rms, _closed(found, s).total - found.total, before.get(s, 0.0))
        for rms, s in found.strength[:MOST]
    )


Place = tuple[int, str, int | None]
"""Axis, the contract's element, and the second axis of a place between two."""


def place_of(structure: Structure, spot: Spot) -> Place:
    """Where a force acts, in the contract's terms; between two loads the element is the first's."""
    if spot.where is Where.PAIR:
        return spot.number, f"mass {structure.sizes[spot.number]}", spot.other
    return (*axis_and_element(structure, spot), None)


def forces_at(bare: FittedHypothesis, end: FittedHypothesis, recording: Recording) -> tuple[ForceAt, ...]:
    """The force at every place that is in no law, without causes and with them, the largest left first."""
    before = {place_of(bare.hypothesis.structure, s): rms for rms, s in bare.strength}
    unit, axes = unit_of("torque", recording.linear), recording.axes
    out = []
    for rms, spot in end.strength:
        axis, element, other = place = place_of(end.hypothesis.structure, spot)
        second = None if other is None else axes[other]
        out.append(ForceAt(axes[axis], element, second, unit, before.get(place, 0.0), rms))
    return tuple(out)
