"""What the plant is made of: matrices in time, force laws, and what happens between drive and motor.

Effects are those of the catalogue, made of the same elements as in ``invid.simulate``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.effects.elements import (
    Element,
    ForceLaw,
    Law,
    ReadingError,
    RepeatedRows,
    TorqueChannel,
    dry_parameters,
)
from invid.effects.registry import CATALOGUE, law_of
from invid.errors import ConfigError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Estimate
from invid.model.matrices import Matrices, mass, spring
from invid.numerics.arrays import Int64
from invid.simulation.laws import Laws, elements_of
from invid.simulation.plant import matrices
from invid_drivers.simulated.config import AxisSimulation, EffectConfig

_MOST_DRIFT = 0.5
"""A drift stops at half of the parameter, so that couplings keep the mass matrix positive in most plants."""
_DRIFT_STEP_S = 0.25
"""A drift that spoils a measurement of minutes moves by 1e-3 of itself meanwhile."""
_MAY_BE_LEFT_OUT = ("phase", "angle", "viscous_positive", "viscous_negative")
"""Parameters that are zero where they are not stated."""
CAUSES = tuple(effect.cause for effect in CATALOGUE)

Channel = TorqueChannel | ReadingError | RepeatedRows


@dataclass(frozen=True, eq=False)
class Structure:
    """Coordinates branch after branch, motor first; hidden masses of extra modes and bases at the end.

    ``forces`` begin with the brake of every motor. ``channels``: what is between drive and motor, by axis.
    """

    chains: CoupledChains
    still: Matrices
    motors: Int64
    laws: Laws
    forces: tuple[ForceLaw, ...]
    channels: tuple[tuple[int, Channel], ...]

    @property
    def dofs(self) -> int:
        """Number of coordinates."""
        return int(self.still.mass.shape[0])

    @property
    def changes(self) -> list[float]:
        """Instants [s] at which the matrices jump."""
        return [load.time for load in self.laws.payloads]

    @property
    def renew_s(self) -> float:
        """How often drifting matrices are renewed; 0: they do not drift."""
        return _DRIFT_STEP_S if self.laws.drifts else 0.0

    def matrices(self, time_s: float) -> Matrices:
        """Those at a time."""
        parts = [mass(load.mass, load.at) for load in self.laws.payloads if time_s >= load.time - 1e-9]
        for drift in self.laws.drifts:
            own = np.concatenate(self.chains.masses)[drift.a]
            if drift.b >= 0:
                own = -self.chains.stiffness_matrix[drift.a, drift.b]
            moved = max(drift.rate * time_s, -_MOST_DRIFT * float(own))
            parts.append(mass(moved, drift.a) if drift.b < 0 else spring(moved, drift.a, drift.b))
        return self.still.plus(parts)


def build_structure(
    chains: CoupledChains, axes: Sequence[AxisSimulation], effects: Sequence[EffectConfig]
) -> Structure:
    """Chains with motor friction and effects.

    Raises
    ------
    ConfigError
        Where an effect is unknown, lacks a parameter, or names an element that is not there.
    """
    laws, channels, motors = Laws(), [], chains.motor_dofs.astype(np.int64)
    for effect in effects:
        for element in _elements(chains, effect):
            if isinstance(element, Channel):
                channels.append((chains.axes.index(effect.axis), element))
            else:
                laws.add(element, _term(effect))
    brakes = [ForceLaw(Law.DRY, at, -1, dry_parameters(0.0)) for at in motors.tolist()]
    frictions = [_friction(axis, at) for axis, at in zip(axes, motors.tolist(), strict=True)]
    if laws.static:
        raise ConfigError("simulation.effects: a law that is a table has no place in the simulated drives")
    structure = Structure(
        chains, matrices(chains, laws), motors, laws, (*brakes, *frictions, *laws.forces), tuple(channels)
    )
    for instant in (0.0, *structure.changes, 1e9):  # the last: wherever a drift ends
        if np.linalg.eigvalsh(structure.matrices(instant).mass)[0] <= 0.0:
            raise ConfigError(
                "simulation.effects: a changed or drifting mass makes the mass matrix not positive definite; "
                "take a smaller change or weaker couplings"
            )
    return structure


def _friction(axis: AxisSimulation, at: int) -> ForceLaw:
    own = axis.friction
    excess = 0.0 if own.static is None else max(own.static - own.coulomb, 0.0)
    return ForceLaw(Law.DRY, at, -1, dry_parameters(own.coulomb, excess, own.stribeck_velocity))


def _term(effect: EffectConfig) -> EffectTerm:
    values = {name: Estimate(value, None) for name, value in effect.parameters.items()}
    return EffectTerm(effect.cause, effect.axis, values, effect.element, effect.other_axis)


def _elements(chains: CoupledChains, effect: EffectConfig) -> Sequence[Element]:
    """Elements of an effect, with messages where something is missing."""
    known = law_of(_term(effect))
    if known is None or effect.cause not in CAUSES:
        raise ConfigError(f"simulation.effects: unknown cause {effect.cause!r}; known are {list(CAUSES)}")
    names = [*known.parameters, *known.optional]
    unknown = sorted(set(effect.parameters) - set(names))
    if unknown:
        raise ConfigError(
            f"simulation.effects: {effect.cause} on {effect.axis}: unknown parameter {unknown[0]!r}; it "
            f"takes {names}"
        )
    left_out = dict.fromkeys(set(names) & set(_MAY_BE_LEFT_OUT), 0.0)
    try:
        return elements_of(
            chains, _term(effect.model_copy(update={"parameters": left_out | effect.parameters}))
        )
    except ModelError as error:
        raise ConfigError(f"simulation.effects: {error}") from None
