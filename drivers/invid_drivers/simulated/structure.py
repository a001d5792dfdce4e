"""What the plant is made of: matrices in time and the tables of forces the kernel evaluates.

Effects compose: each cause of the contract adds rows, coordinates or changes in time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eigh

from invid.errors import ConfigError
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64, Int64
from invid_drivers.simulated import kernel
from invid_drivers.simulated.config import AxisSimulation, EffectConfig

_EXTRA_DAMPING = 0.01
"""Damping ratio of an extra mode: what a screwed joint has; ``invid.simulate`` takes the same."""

_MOST_DRIFT = 0.5
"""A drift stops at half of the parameter, so that couplings keep the mass matrix positive in most plants."""

_MAY_BE_LEFT_OUT = {"phase": 0.0, "angle": 0.0, "1": 1.0}
"""Parameters with a value of their own, and the constant one."""
_RIPPLE, _ERROR = ("torque", "cycles_per_rev", "phase"), ("amplitude", "cycles_per_rev", "phase")

Matrices = tuple[Float64, Float64, Float64]


@dataclass
class Structure:
    """Coordinates branch after branch, motor first; hidden masses of extra modes at the end."""

    chains: CoupledChains
    mass: Float64
    damping: Float64
    stiffness: Float64
    motors: Int64
    elements: Float64 = field(default_factory=lambda: np.zeros((0, kernel.ELEMENT_COLUMNS)))
    friction: Float64 = field(default_factory=lambda: np.zeros((0, kernel.FRICTION_COLUMNS)))
    changes: list[float] = field(default_factory=list)
    """Instants [s] at which the matrices jump."""
    renew_s: float = 0.0
    """How often drifting matrices are renewed; 0: they do not drift."""
    in_time: list[Callable[[float, Float64, Float64, Float64], None]] = field(default_factory=list)
    motor_effects: list[EffectConfig] = field(default_factory=list)
    """Causes between drive and motor; the cell sets them into the drives' tables."""

    @property
    def dofs(self) -> int:
        """Number of coordinates."""
        return int(self.mass.shape[0])

    def matrices(self, time_s: float) -> Matrices:
        """Mass, damping and stiffness at a time."""
        if not self.in_time:
            return self.mass, self.damping, self.stiffness
        mass, damping, stiffness = self.mass.copy(), self.damping.copy(), self.stiffness.copy()
        for change in self.in_time:
            change(time_s, mass, damping, stiffness)
        return mass, damping, stiffness

    def fastest_mode(self) -> float:
        """Highest undamped angular frequency [rad/s]."""
        return float(np.sqrt(max(eigh(self.stiffness, self.mass, eigvals_only=True)[-1], 0.0)))

    def add_element(self, kind: int, a: int, b: int, *parameters: float) -> None:
        """Add one nonlinear element."""
        row = np.zeros(kernel.ELEMENT_COLUMNS)
        row[: 3 + len(parameters)] = (kind, a, b, *parameters)
        self.elements = np.vstack([self.elements, row])

    def add_friction(
        self,
        dof: int,
        positive: float,
        negative: float,
        *,
        excess: float = 0.0,
        stribeck_velocity: float = 1.0,
        brake_of: int = -1,
    ) -> None:
        """Add one dry friction row."""
        row = np.array([dof, positive, negative, excess, stribeck_velocity, brake_of], dtype=float)
        self.friction = np.vstack([self.friction, row])

    def add_mass(self, dof: int, mass: float, stiffness: float) -> None:
        """Add a further mass on a spring, with 1 % damping."""
        n = self.dofs
        for name in ("mass", "damping", "stiffness"):
            grown = np.zeros((n + 1, n + 1))
            grown[:n, :n] = getattr(self, name)
            setattr(self, name, grown)
        self.mass[n, n] = mass
        self.add_link("stiffness", dof, n, stiffness)
        self.add_link("damping", dof, n, 2.0 * _EXTRA_DAMPING * math.sqrt(stiffness * mass))

    def add_link(self, name: str, a: int, b: int, value: float) -> None:
        """Add a spring or damper between two coordinates."""
        _link(getattr(self, name), a, b, value)


def _link(matrix: Float64, a: int, b: int, value: float) -> None:
    matrix[a, a] += value
    matrix[b, b] += value
    matrix[a, b] -= value
    matrix[b, a] -= value


def build_structure(
    chains: CoupledChains, axes: Sequence[AxisSimulation], effects: Sequence[EffectConfig]
) -> Structure:
    """Chains with motor friction and effects.

    Raises
    ------
    ConfigError
        Where an effect is unknown, lacks a parameter, or names an element that is not there.
    """
    structure = Structure(
        chains=chains,
        mass=chains.mass_matrix,
        damping=chains.damping_matrix,
        stiffness=chains.stiffness_matrix,
        motors=chains.motor_dofs.astype(np.int64),
    )
    for i, axis in enumerate(axes):
        f = axis.friction
        static = f.coulomb if f.static is None else f.static
        structure.add_friction(
            int(structure.motors[i]),
            f.coulomb,
            f.coulomb,
            excess=max(static - f.coulomb, 0.0),
            stribeck_velocity=f.stribeck_velocity,
            brake_of=i,
        )
    for effect in effects:
        _apply(structure, effect)
    for instant in (0.0, *structure.changes, 1e9):  # the last: wherever a drift ends
        if np.linalg.eigvalsh(structure.matrices(instant)[0])[0] <= 0.0:
            raise ConfigError(
                "simulation.effects: a changed or drifting mass makes the mass matrix not positive definite; "
                "take a smaller change or weaker couplings"
            )
    return structure


class _Place:
    """An effect's parameters and place, looked up with messages where something is missing."""

    def __init__(self, structure: Structure, effect: EffectConfig, names: tuple[str, ...]) -> None:
        self.effect, self.names = effect, names
        self.where = f"simulation.effects: {effect.cause} on {effect.axis}"
        unknown = sorted(set(effect.parameters) - set(names))
        if unknown:
            raise ConfigError(f"{self.where}: unknown parameter {unknown[0]!r}; it takes {list(names)}")
        chains = structure.chains
        self.branch = chains.axes.index(effect.axis)
        self.start = int(chains.motor_dofs[self.branch])
        self.count = chains.masses_per_branch[self.branch]

    def __getitem__(self, name: str) -> float:
        try:
            return self.effect.parameters[name]
        except KeyError:
            raise ConfigError(f"{self.where}: parameter {name!r} is missing") from None

    def value(self, name: str) -> float:
        """A parameter, or the constant that stands for it where it may be left out."""
        return self.get(name, _MAY_BE_LEFT_OUT[name]) if name in _MAY_BE_LEFT_OUT else self[name]

    def get(self, name: str, default: float) -> float:
        """A parameter that may be left out."""
        return self.effect.parameters.get(name, default)

    def _number(self, kind: str, count: int, default: int) -> int:
        if self.effect.element is None:
            if count == 0:
                raise ConfigError(f"{self.where}: the branch has no {kind}")
            return default
        match = re.fullmatch(rf"{kind} (\d+)", self.effect.element)
        if match is None or not 1 <= int(match[1]) <= count:
            raise ConfigError(
                f"{self.where}: element {self.effect.element!r}; it must be '{kind} 1' to '{kind} {count}'"
            )
        return int(match[1])

    def mass(self, *, last: bool = False) -> int:
        """Coordinate of "mass q"; default the motor, or the last mass."""
        return self.start + self._number("mass", self.count, self.count if last else 1) - 1

    def spring(self) -> tuple[int, int, int]:
        """Index within the branch and the two coordinates of "spring s"."""
        s = self._number("spring", self.count - 1, 1) - 1
        return s, self.start + s, self.start + s + 1


Build = Callable[[Structure, _Place], None]


def _viscous(structure: Structure, place: _Place) -> None:
    a = place.mass()
    structure.damping[a, a] += place["coefficient"]


def _coulomb(structure: Structure, place: _Place) -> None:
    structure.add_friction(place.mass(), place["torque"], place["torque"])


def _stribeck(structure: Structure, place: _Place) -> None:
    coulomb, excess = place["coulomb"], max(place["static"] - place["coulomb"], 0.0)
    structure.add_friction(place.mass(), coulomb, coulomb, excess=excess, stribeck_velocity=place["velocity"])


def _asymmetric(structure: Structure, place: _Place) -> None:
    a = place.mass()
    structure.add_friction(a, place["coulomb_positive"], place["coulomb_negative"])
    positive, negative = place.get("viscous_positive", 0.0), place.get("viscous_negative", 0.0)
    structure.damping[a, a] += 0.5 * (positive + negative)
    structure.add_element(kernel.ABSOLUTE, a, -1, 0.5 * (positive - negative))


def _at_mass(kind: int, *names: str, last: bool = False) -> Build:
    """A nonlinear element between a mass and ground; a parameter "1" is one, an angle may be left out."""

    def build(structure: Structure, place: _Place) -> None:
        structure.add_element(kind, place.mass(last=last), -1, *map(place.value, names))

    return build


def _at_spring(kind: int, *names: str) -> Build:
    """A nonlinear element across a spring; "k" and "d" are the spring's own stiffness and damper."""

    def build(structure: Structure, place: _Place) -> None:
        s, a, b = place.spring()
        own = {"k": structure.chains.springs[place.branch][s], "d": structure.chains.dampers[place.branch][s]}
        structure.add_element(kind, a, b, *(float(own[n]) if n in own else place.value(n) for n in names))

    return build


def _spring_damping(structure: Structure, place: _Place) -> None:
    structure.add_link("damping", *place.spring()[1:], place["coefficient"])


def _extra_mode(structure: Structure, place: _Place) -> None:
    structure.add_mass(place.mass(last=True), place["mass"], place["stiffness"])


def _coupling(structure: Structure, place: _Place) -> None:
    axis, other = place.effect.axis, place.effect.other_axis
    if other is None or other == axis:
        raise ConfigError(f"{place.where}: give other_axis, the second of the two axes")
    ends = structure.chains.end_dofs
    second = structure.chains.axes.index(other)
    structure.add_link("stiffness", int(ends[place.branch]), int(ends[second]), place["stiffness"])


def _payload(structure: Structure, place: _Place) -> None:
    end, extra, instant = place.mass(last=True), place["mass"], place["time"]

    def change(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
        if time_s >= instant - 1e-9:
            mass[end, end] += extra

    structure.in_time.append(change)
    structure.changes.append(instant)


def _drift(structure: Structure, place: _Place) -> None:
    rate = place["rate"]
    # a quarter of a second: a drift that spoils a measurement of minutes moves by 1e-3 of itself in it
    structure.renew_s = 0.25
    if (place.effect.element or "").startswith("mass"):
        a = place.mass()
        value = float(np.concatenate(structure.chains.masses)[a])

        def change(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
            mass[a, a] += max(rate * time_s, -_MOST_DRIFT * value)

    else:
        s, left, right = place.spring()
        k = float(structure.chains.springs[place.branch][s])

        def change(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
            _link(stiffness, left, right, max(rate * time_s, -_MOST_DRIFT * k))

    structure.in_time.append(change)


def _between_drive_and_motor(structure: Structure, place: _Place) -> None:
    for name in set(place.names) - set(_MAY_BE_LEFT_OUT):
        _ = place[name]
    structure.motor_effects.append(place.effect)


_CAUSES: dict[str, tuple[tuple[str, ...], Build]] = {
    "coulomb_friction": (("torque",), _coulomb),
    "viscous_friction": (("coefficient",), _viscous),
    "stribeck_friction": (("static", "coulomb", "velocity"), _stribeck),
    "presliding_friction": (("stiffness", "torque"), _at_mass(kernel.JENKINS, "stiffness", "torque")),
    "asymmetric_friction": (
        ("coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative"), _asymmetric,
    ),
    "torque_offset": (("torque",), _at_mass(kernel.OFFSET, "torque")),
    "cogging": (_RIPPLE, _at_mass(kernel.SINE, *_RIPPLE)),
    "spring_damping": (("coefficient",), _spring_damping),
    "cubic_stiffness": (("coefficient",), _at_spring(kernel.CUBIC, "coefficient")),
    "backlash": (("gap",), _at_spring(kernel.BACKLASH, "k", "d", "gap")),
    "spring_hysteresis": (("stiffness", "torque"), _at_spring(kernel.JENKINS, "stiffness", "torque")),
    "transmission_error": (_ERROR, _at_spring(kernel.TRANSMISSION, "k", *_ERROR)),
    "gravity": (("torque", "angle"), _at_mass(kernel.SINE, "torque", "1", "angle", last=True)),
    "extra_mode": (("mass", "stiffness"), _extra_mode),
    "coupling_stiffness": (("stiffness",), _coupling),
    "payload_change": (("mass", "time"), _payload),
    "parameter_drift": (("rate", "parameter"), _drift),
    "torque_delay": (("delay",), _between_drive_and_motor),
    "torque_lag": (("time_constant",), _between_drive_and_motor),
    "torque_gain": (("gain",), _between_drive_and_motor),
    "torque_saturation": (("limit",), _between_drive_and_motor),
    "encoder_eccentricity": (("amplitude", "phase"), _between_drive_and_motor),
    "dropped_samples": (("fraction",), _between_drive_and_motor),
}  # fmt: skip
"""Of each cause its parameters and what builds it."""
CAUSES = tuple(_CAUSES)


def _apply(structure: Structure, effect: EffectConfig) -> None:
    if effect.cause not in _CAUSES:
        raise ConfigError(f"simulation.effects: unknown cause {effect.cause!r}; known are {list(CAUSES)}")
    names, build = _CAUSES[effect.cause]
    build(structure, _Place(structure, effect, names))
