"""What a plan would show of causes, before anything moves: for each the smallest size that it finds.

The limits of a diagnosis (``invid.diagnosis.unknown_forces.limits``) on the records that the believed plant
would give: a law of that size passes its price in 95 of 100 recordings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.diagnosis.unknown_forces.limits import Screen
from invid.diagnosis.unknown_forces.scoring import spot_at
from invid.effects.registry import effects
from invid.effects.units import unit_of
from invid.identification.fitted_model import chains_of
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.place import Place
from invid.model.plant import Structure
from invid.planning.belief import Belief
from invid.planning.expected_covariance import Noise, fit_about
from invid.planning.model import PlannedExperiment
from invid.recording.model import Recording

FRICTION = ((Part.DRY, "coulomb_friction", "torque"), (Part.VISCOUS, "viscous_friction", "coefficient"))


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest size of a cause at the worst of an axis' places, beside the size of interest."""

    cause: str
    axis: str
    size: float
    """Infinite where the plan shows nothing of it."""
    interest: float
    unit: str
    """Of both."""

    @property
    def is_met(self) -> bool:
        """Whether the plan shows what is of interest."""
        return self.size <= self.interest

    def to_json(self) -> dict[str, Any]:
        """Plain values; ``null`` where the plan shows nothing of the cause."""
        return {
            "cause": self.cause,
            "axis": self.axis,
            "limit": self.size if np.isfinite(self.size) else None,
            "of_interest": self.interest,
            "unit": self.unit,
            "met": self.is_met,
        }


def detection_limits(
    config: CellConfig, experiments: Sequence[PlannedExperiment], belief: Belief, noise: Noise
) -> tuple[DetectionLimit, ...]:
    """What planned experiments would show on the believed plant."""
    return limits_at(config, *fit_about(config, experiments, belief, noise))


def limits_at(config: CellConfig, now: FittedHypothesis, recording: Recording) -> tuple[DetectionLimit, ...]:
    """Limits of dry and viscous friction of each motor, free play of its springs and a mode on its load, in a
    recording that ``now`` fits.

    A mode shows at some frequencies better than at others: its limit is the median over those that a
    diagnosis asks for.
    """
    # A search leaves out what rises at slow speed before it asks what friction is worth.
    rises = {(Part.RISE, motor) for motor in range(len(config.axes))}
    plain = replace(now.hypothesis, absent=now.hypothesis.absent | rises)
    now = now.refit(plain, iterations=0).smoothed().refit(iterations=0)
    screen, (chains, _) = Screen(now, recording), chains_of(now, recording.axes)
    found: list[DetectionLimit] = []
    for axis, settings in enumerate(config.axes):
        rated = settings.rated_torque or settings.limits.torque
        wanted = config.sizes_of_interest
        interest = {
            "coulomb_friction": wanted.dry_friction * rated,
            "viscous_friction": wanted.viscous_friction * rated / settings.limits.velocity,
            "backlash": wanted.free_play,
            "extra_mode": wanted.mode * float(chains.masses[axis].sum()),
        }
        sizes = {cause: _of_friction(now, screen, (part, axis), name) for part, cause, name in FRICTION}
        sizes["backlash"] = max(_of_play(screen, axis), default=np.nan)
        sizes["extra_mode"] = _of_mode(screen, axis)
        found += [
            DetectionLimit(cause, settings.name, size, interest[cause], _unit(cause, config.linear))
            for cause, size in sizes.items()
            if not np.isnan(size)
        ]
    return tuple(found)


def _unit(cause: str, linear: bool) -> str:
    effect = next(e for e in effects() if e.cause == cause)
    return unit_of(effect.parameters["mass" if "mass" in effect.parameters else effect.main], linear)


def _of_friction(now: FittedHypothesis, screen: Screen, key: tuple[Part, int], parameter: str) -> float:
    """Limit of a part of a motor's friction that the fit holds already: as if it were not there. An axis that
    stands still has none in its fit."""
    if key in now.hypothesis.absent:
        return np.inf
    less = now.refit(replace(now.hypothesis, absent=now.hypothesis.absent | {key}), iterations=0)
    limit = Screen(less, screen.recording).of_friction(*key, parameter)
    return np.inf if limit is None else limit.size


def _places(screen: Screen, cause: str, axis: int) -> Iterator[Place]:
    chains = Structure(screen.structure.sizes)
    return (p for e in effects() if e.cause == cause for p in e.places(chains) if p.axis == axis)


def _of_play(screen: Screen, axis: int) -> Iterator[float]:
    law = next(law for law in screen.laws if law.cause == "backlash")
    for place in _places(screen, "backlash", axis):
        for limit in screen.of_law(law, spot_at(screen.structure, place), "gap"):
            yield np.inf if limit is None else limit.size


def _of_mode(screen: Screen, axis: int) -> float:
    load = max(_places(screen, "extra_mode", axis), key=lambda place: place.number)
    limits = [np.inf if limit is None else limit.size for limit in screen.of_mode(load, "mass")]
    return float(np.median(limits))
