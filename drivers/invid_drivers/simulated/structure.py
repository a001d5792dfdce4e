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
        """One nonlinear element."""
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
        """One dry friction row."""
        row = np.array([dof, positive, negative, excess, stribeck_velocity, brake_of], dtype=float)
        self.friction = np.vstack([self.friction, row])

    def add_mass(self, dof: int, mass: float, stiffness: float) -> None:
        """A further mass on a spring, with 1 % damping."""
        n = self.dofs
        for name in ("mass", "damping", "stiffness"):
            grown = np.zeros((n + 1, n + 1))
            grown[:n, :n] = getattr(self, name)
            setattr(self, name, grown)
        self.mass[n, n] = mass
        self.add_link("stiffness", dof, n, stiffness)
        self.add_link("damping", dof, n, 2.0 * _EXTRA_DAMPING * math.sqrt(stiffness * mass))

    def add_link(self, name: str, a: int, b: int, value: float) -> None:
        """A spring or damper between two coordinates."""
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
    """An effect's parameters and place, looked up with messages."""

    def __init__(self, structure: Structure, effect: EffectConfig, names: tuple[str, ...]) -> None:
        self.effect = effect
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

    def get(self, name: str, default: float) -> float:
        """Optional parameter."""
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


MOTOR_CAUSES: dict[str, tuple[str, ...]] = {
    "torque_delay": ("delay",),
    "torque_lag": ("time_constant",),
    "torque_gain": ("gain",),
    "torque_saturation": ("limit",),
    "encoder_eccentricity": ("amplitude", "phase"),
    "dropped_samples": ("fraction",),
}

_STRUCTURE_CAUSES: dict[str, tuple[str, ...]] = {
    "coulomb_friction": ("torque",),
    "viscous_friction": ("coefficient",),
    "stribeck_friction": ("static", "coulomb", "velocity"),
    "presliding_friction": ("stiffness", "torque"),
    "asymmetric_friction": (
        "coulomb_positive",
        "coulomb_negative",
        "viscous_positive",
        "viscous_negative",
    ),
    "torque_offset": ("torque",),
    "cogging": ("torque", "cycles_per_rev", "phase"),
    "spring_damping": ("coefficient",),
    "cubic_stiffness": ("coefficient",),
    "backlash": ("gap",),
    "spring_hysteresis": ("stiffness", "torque"),
    "transmission_error": ("amplitude", "cycles_per_rev", "phase"),
    "gravity": ("torque", "angle"),
    "extra_mode": ("mass", "stiffness"),
    "coupling_stiffness": ("stiffness",),
    "payload_change": ("mass", "time"),
    "parameter_drift": ("rate", "parameter"),
}

CAUSES = tuple(_STRUCTURE_CAUSES) + tuple(MOTOR_CAUSES)


def _apply(structure: Structure, effect: EffectConfig) -> None:
    cause = effect.cause
    if cause in MOTOR_CAUSES:
        place = _Place(structure, effect, MOTOR_CAUSES[cause])
        for name in MOTOR_CAUSES[cause]:
            if name != "phase":
                _ = place[name]
        structure.motor_effects.append(effect)
        return
    if cause not in _STRUCTURE_CAUSES:
        raise ConfigError(f"simulation.effects: unknown cause {cause!r}; known are {list(CAUSES)}")
    place = _Place(structure, effect, _STRUCTURE_CAUSES[cause])
    if cause in ("coulomb_friction", "stribeck_friction", "asymmetric_friction", "presliding_friction"):
        _apply_friction(structure, place)
    elif cause in ("payload_change", "parameter_drift"):
        _apply_change(structure, place)
    elif cause in (
        "cubic_stiffness",
        "backlash",
        "spring_hysteresis",
        "transmission_error",
        "spring_damping",
    ):
        _apply_spring(structure, place)
    elif cause == "viscous_friction":
        a = place.mass()
        structure.damping[a, a] += place["coefficient"]
    elif cause == "torque_offset":
        structure.add_element(kernel.OFFSET, place.mass(), -1, place["torque"])
    elif cause == "cogging":
        structure.add_element(
            kernel.SINE, place.mass(), -1, place["torque"], place["cycles_per_rev"], place.get("phase", 0.0)
        )
    elif cause == "gravity":
        structure.add_element(
            kernel.SINE, place.mass(last=True), -1, place["torque"], 1.0, place.get("angle", 0.0)
        )
    elif cause == "extra_mode":
        structure.add_mass(place.mass(last=True), place["mass"], place["stiffness"])
    elif cause == "coupling_stiffness":
        if effect.other_axis is None or effect.other_axis == effect.axis:
            raise ConfigError(f"{place.where}: give other_axis, the second of the two axes")
        ends = structure.chains.end_dofs
        other = structure.chains.axes.index(effect.other_axis)
        structure.add_link("stiffness", int(ends[place.branch]), int(ends[other]), place["stiffness"])


def _apply_friction(structure: Structure, place: _Place) -> None:
    a = place.mass()
    cause = place.effect.cause
    if cause == "coulomb_friction":
        structure.add_friction(a, place["torque"], place["torque"])
    elif cause == "stribeck_friction":
        structure.add_friction(
            a,
            place["coulomb"],
            place["coulomb"],
            excess=max(place["static"] - place["coulomb"], 0.0),
            stribeck_velocity=place["velocity"],
        )
    elif cause == "presliding_friction":
        structure.add_element(kernel.JENKINS, a, -1, place["stiffness"], place["torque"])
    else:
        structure.add_friction(a, place["coulomb_positive"], place["coulomb_negative"])
        positive, negative = place.get("viscous_positive", 0.0), place.get("viscous_negative", 0.0)
        structure.damping[a, a] += 0.5 * (positive + negative)
        structure.add_element(kernel.ABSOLUTE, a, -1, 0.5 * (positive - negative))


def _apply_spring(structure: Structure, place: _Place) -> None:
    s, a, b = place.spring()
    k = float(structure.chains.springs[place.branch][s])
    d = float(structure.chains.dampers[place.branch][s])
    cause = place.effect.cause
    if cause == "spring_damping":
        structure.add_link("damping", a, b, place["coefficient"])
    elif cause == "cubic_stiffness":
        structure.add_element(kernel.CUBIC, a, b, place["coefficient"])
    elif cause == "backlash":
        structure.add_element(kernel.BACKLASH, a, b, k, d, place["gap"])
    elif cause == "spring_hysteresis":
        structure.add_element(kernel.JENKINS, a, b, place["stiffness"], place["torque"])
    else:
        structure.add_element(
            kernel.TRANSMISSION,
            a,
            b,
            k,
            place["amplitude"],
            place["cycles_per_rev"],
            place.get("phase", 0.0),
        )


def _apply_change(structure: Structure, place: _Place) -> None:
    effect = place.effect
    if effect.cause == "payload_change":
        end, extra, instant = place.mass(last=True), place["mass"], place["time"]

        def payload(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
            if time_s >= instant - 1e-9:
                mass[end, end] += extra

        structure.in_time.append(payload)
        structure.changes.append(instant)
        return
    rate = place["rate"]
    # a quarter of a second: a drift that spoils a measurement of minutes moves by 1e-3 of itself in it
    structure.renew_s = 0.25
    if effect.element is not None and effect.element.startswith("mass"):
        a = place.mass()
        value = float(np.concatenate(structure.chains.masses)[a])

        def drift_mass(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
            mass[a, a] += max(rate * time_s, -_MOST_DRIFT * value)

        structure.in_time.append(drift_mass)
        return
    s, left, right = place.spring()
    k = float(structure.chains.springs[place.branch][s])

    def drift_spring(time_s: float, mass: Float64, damping: Float64, stiffness: Float64) -> None:
        _link(stiffness, left, right, max(rate * time_s, -_MOST_DRIFT * k))

    structure.in_time.append(drift_spring)
