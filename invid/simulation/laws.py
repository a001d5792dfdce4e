"""Effects of a model as force laws of the simulator: what each cause means, in one place.

Signs: friction, damping, cogging, gravity and offset are resistances, so they enter with a minus. θ is
the position of the mass, d = q_s − q_{s+1} the deflection of spring s (motor side minus load side).

====================== ==============================================================================
cause                  force on the mass (springs: on mass s, and its opposite on mass s + 1)
====================== ==============================================================================
coulomb_friction       −torque·sgn(θ̇); at rest whatever holds it, up to ±torque
viscous_friction       −coefficient·θ̇
stribeck_friction      as Coulomb with level coulomb + (static − coulomb)·exp(−(|θ̇|/velocity)^exponent);
                       exponent 2 where it is not given
presliding_friction    −stiffness·z: a spring that slides at ±torque (elastoplastic)
asymmetric_friction    −coulomb_positive − viscous_positive·θ̇ for θ̇ > 0; _negative for θ̇ < 0; with
                       low_speed_velocity: low_speed_positive (_negative) times the same exponential more
torque_offset          −torque
cogging                −torque·sin(cycles_per_rev·θ + phase), motor
gravity                −torque·sin(θ + angle), final mass unless ``element`` says otherwise
torque_saturation      acting torque = recorded, clipped to ±limit
torque_gain            acting torque = gain·recorded
torque_delay           acting torque(t) = recorded(t − delay); negative: leading
torque_lag             time_constant·Ṫ + T = recorded
encoder_eccentricity   reading = θ + amplitude·sin(θ + phase)
dropped_samples        each row of the output repeats the one before with probability ``fraction``
spring_damping         −coefficient·ḋ
cubic_stiffness        −coefficient·d³
backlash               spring and damper act on the part of d beyond ±gap/2
spring_hysteresis      −stiffness·z beside the spring: slides at ±torque
transmission_error     spring acts on d − e, e = amplitude·sin(cycles_per_rev·q_s + phase); mass s feels
                       it times 1 − ∂e/∂q_s (no energy is made)
extra_mode             a mass on a spring (``damping_ratio``, default 1 %) at the mass named, or the final one
coupling_stiffness     a spring between the final masses of two axes
payload_change         ``mass`` added to the final mass from ``time`` on (the recording's clock)
parameter_drift        spring s (or mass q) changes by ``rate`` per second from the recording's start
====================== ==============================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from invid.errors import ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

EXTRA_MODE_DAMPING = 0.01


class Law(IntEnum):
    """Laws of the compiled kernel; parameters in brackets."""

    DRY = 0  # [level up, level down, excess up, Stribeck velocity, excess down, exponent]
    ONE_SIDED_VISCOUS = 1  # [coefficient up, coefficient down]
    SLIDER = 2  # [stiffness, torque] on one mass
    SINE = 3  # [torque, cycles, phase]
    CONSTANT = 4  # [torque]
    CUBIC = 5  # [coefficient]
    BACKLASH = 6  # [half gap, stiffness, damping]
    PAIR_SLIDER = 7  # [stiffness, torque] beside a spring
    TRANSMISSION = 8  # [amplitude, cycles, phase, stiffness]


PARAMETERS = 6


@dataclass(frozen=True)
class ForceLaw:
    """One law at its place: coordinates ``a`` and, for pairs, ``b`` (−1: none)."""

    law: Law
    a: int
    b: int
    parameters: tuple[float, ...]


@dataclass(eq=False)
class Laws:
    """A model's effects, sorted by where the simulator treats them."""

    forces: list[ForceLaw] = field(default_factory=list)
    stiffness: list[tuple[int, int, float]] = field(default_factory=list)
    """(a, b, value) springs to add, b = −1: to ground."""
    damping: list[tuple[int, int, float]] = field(default_factory=list)
    extra_masses: list[tuple[int, float, float, float]] = field(default_factory=list)
    """(at, mass, stiffness, damping ratio)."""
    gain: dict[int, float] = field(default_factory=dict)
    delay: dict[int, float] = field(default_factory=dict)
    lag: dict[int, float] = field(default_factory=dict)
    limit: dict[int, float] = field(default_factory=dict)
    eccentricity: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    dropped: float = 0.0
    payloads: list[tuple[int, float, float]] = field(default_factory=list)
    """(coordinate, mass, time)."""
    drifts: list[tuple[int, int, float]] = field(default_factory=list)
    """(a, b, rate) of a spring, b = −1 of a mass."""


class _Place:
    def __init__(self, chains: CoupledChains, term: EffectTerm) -> None:
        self.chains, self.term = chains, term
        try:
            self.axis = chains.axes.index(term.axis)
        except ValueError:
            raise ModelError(
                f"effect {term.cause}: no branch called {term.axis!r}; found {list(chains.axes)}"
            ) from None

    def _number(self, kind: str, default: int) -> int:
        element = self.term.element
        if element is None:
            return default
        word, _, number = element.partition(" ")
        if word != kind or not number.isdigit() or int(number) < 1:
            raise ModelError(
                f"effect {self.term.cause} on {self.term.axis}: element {element!r}; it needs '{kind} n'"
            )
        return int(number)

    def mass(self, default: int = 1) -> int:
        size = self.chains.masses[self.axis].size
        q = self._number("mass", default)
        if q > size:
            raise ModelError(f"effect {self.term.cause} on {self.term.axis}: mass {q} of {size}")
        return int(self.chains.motor_dofs[self.axis]) + q - 1

    def spring(self) -> tuple[int, int, float, float]:
        springs = self.chains.springs[self.axis]
        s = self._number("spring", 1)
        if s > springs.size:
            raise ModelError(f"effect {self.term.cause} on {self.term.axis}: spring {s} of {springs.size}")
        a = int(self.chains.motor_dofs[self.axis]) + s - 1
        return a, a + 1, float(springs[s - 1]), float(self.chains.dampers[self.axis][s - 1])

    @property
    def last(self) -> int:
        return int(self.chains.masses[self.axis].size)


def laws_of(chains: CoupledChains, effects: tuple[EffectTerm, ...]) -> Laws:
    """All effects as laws; ModelError names the effect that cannot be simulated and why."""
    laws = Laws()
    for term in effects:
        try:
            add = _CAUSES[term.cause]
        except KeyError:
            raise ModelError(
                f"effect {term.cause!r} on {term.axis} cannot be simulated; known: "
                f"{', '.join(sorted(_CAUSES))}"
            ) from None
        add(laws, _Place(chains, term), term.value)
    return laws


_Value = Callable[[str], float]


def _dry(
    level: float, excess: float = 0.0, velocity: float = 1.0, exponent: float = 2.0
) -> tuple[float, ...]:
    return (level, level, excess, velocity, excess, exponent)


def _exponent(term: EffectTerm) -> float:
    return term.value("exponent") if "exponent" in term.parameters else 2.0


def _coulomb(laws: Laws, at: _Place, value: _Value) -> None:
    laws.forces.append(ForceLaw(Law.DRY, at.mass(), -1, _dry(abs(value("torque")))))


def _viscous(laws: Laws, at: _Place, value: _Value) -> None:
    laws.damping.append((at.mass(), -1, value("coefficient")))


def _stribeck(laws: Laws, at: _Place, value: _Value) -> None:
    velocity = abs(value("velocity"))
    if velocity == 0:
        raise ModelError(f"effect stribeck_friction on {at.term.axis}: velocity is 0; it must be > 0")
    excess = value("static") - value("coulomb")
    laws.forces.append(
        ForceLaw(Law.DRY, at.mass(), -1, _dry(value("coulomb"), excess, velocity, _exponent(at.term)))
    )


def _presliding(laws: Laws, at: _Place, value: _Value) -> None:
    parameters = (_positive(at, value, "stiffness"), abs(value("torque")))
    laws.forces.append(ForceLaw(Law.SLIDER, at.mass(), -1, parameters))


def _asymmetric(laws: Laws, at: _Place, value: _Value) -> None:
    a = at.mass()
    up, down, velocity = 0.0, 0.0, 1.0
    if "low_speed_velocity" in at.term.parameters:
        up, down = value("low_speed_positive"), value("low_speed_negative")
        velocity = _positive(at, value, "low_speed_velocity")
    levels = (value("coulomb_positive"), value("coulomb_negative"), up, velocity, down, _exponent(at.term))
    laws.forces.append(ForceLaw(Law.DRY, a, -1, levels))
    sides = (value("viscous_positive"), value("viscous_negative"))
    laws.forces.append(ForceLaw(Law.ONE_SIDED_VISCOUS, a, -1, sides))


def _offset(laws: Laws, at: _Place, value: _Value) -> None:
    laws.forces.append(ForceLaw(Law.CONSTANT, at.mass(), -1, (value("torque"),)))


def _cogging(laws: Laws, at: _Place, value: _Value) -> None:
    parameters = (value("torque"), value("cycles_per_rev"), value("phase"))
    laws.forces.append(ForceLaw(Law.SINE, at.mass(), -1, parameters))


def _gravity(laws: Laws, at: _Place, value: _Value) -> None:
    parameters = (value("torque"), 1.0, value("angle"))
    laws.forces.append(ForceLaw(Law.SINE, at.mass(at.last), -1, parameters))


def _saturation(laws: Laws, at: _Place, value: _Value) -> None:
    laws.limit[at.axis] = abs(value("limit"))


def _gain(laws: Laws, at: _Place, value: _Value) -> None:
    laws.gain[at.axis] = laws.gain.get(at.axis, 1.0) * value("gain")


def _delay(laws: Laws, at: _Place, value: _Value) -> None:
    laws.delay[at.axis] = laws.delay.get(at.axis, 0.0) + value("delay")


def _lag(laws: Laws, at: _Place, value: _Value) -> None:
    laws.lag[at.axis] = _positive(at, value, "time_constant")


def _eccentricity(laws: Laws, at: _Place, value: _Value) -> None:
    laws.eccentricity.setdefault(at.axis, []).append((value("amplitude"), value("phase")))


def _dropped(laws: Laws, at: _Place, value: _Value) -> None:
    fraction = value("fraction")
    if not 0 <= fraction < 1:
        raise ModelError(f"effect dropped_samples on {at.term.axis}: fraction is {fraction}; need 0 ≤ x < 1")
    laws.dropped = 1.0 - (1.0 - laws.dropped) * (1.0 - fraction)


def _spring_damping(laws: Laws, at: _Place, value: _Value) -> None:
    a, b, _, _ = at.spring()
    laws.damping.append((a, b, value("coefficient")))


def _cubic(laws: Laws, at: _Place, value: _Value) -> None:
    a, b, _, _ = at.spring()
    laws.forces.append(ForceLaw(Law.CUBIC, a, b, (value("coefficient"),)))


def _backlash(laws: Laws, at: _Place, value: _Value) -> None:
    a, b, stiffness, damping = at.spring()
    laws.forces.append(ForceLaw(Law.BACKLASH, a, b, (0.5 * abs(value("gap")), stiffness, damping)))


def _hysteresis(laws: Laws, at: _Place, value: _Value) -> None:
    a, b, _, _ = at.spring()
    parameters = (_positive(at, value, "stiffness"), abs(value("torque")))
    laws.forces.append(ForceLaw(Law.PAIR_SLIDER, a, b, parameters))


def _transmission(laws: Laws, at: _Place, value: _Value) -> None:
    a, b, stiffness, _ = at.spring()
    parameters = (value("amplitude"), value("cycles_per_rev"), value("phase"), stiffness)
    laws.forces.append(ForceLaw(Law.TRANSMISSION, a, b, parameters))


def _extra_mode(laws: Laws, at: _Place, value: _Value) -> None:
    at_mass = at.mass(at.last)
    given = at.term.parameters.get("damping_ratio")
    ratio = EXTRA_MODE_DAMPING if given is None else max(given.value, 0.0)
    size = (_positive(at, value, "mass"), _positive(at, value, "stiffness"))
    laws.extra_masses.append((at_mass, *size, ratio))


def _coupling_stiffness(laws: Laws, at: _Place, value: _Value) -> None:
    other = at.term.other_axis
    if other is None or other not in at.chains.axes or other == at.term.axis:
        raise ModelError(
            f"effect coupling_stiffness on {at.term.axis}: other_axis is {other!r}; it must be another of "
            f"{list(at.chains.axes)}"
        )
    ends = at.chains.end_dofs
    pair = int(ends[at.axis]), int(ends[at.chains.axes.index(other)])
    laws.stiffness.append((*pair, value("stiffness")))


def _payload(laws: Laws, at: _Place, value: _Value) -> None:
    laws.payloads.append((at.mass(at.last), value("mass"), value("time")))


def _drift(laws: Laws, at: _Place, value: _Value) -> None:
    if (at.term.element or "spring 1").startswith("mass"):
        laws.drifts.append((at.mass(), -1, value("rate")))
    else:
        a, b, _, _ = at.spring()
        laws.drifts.append((a, b, value("rate")))


def _positive(at: _Place, value: _Value, name: str) -> float:
    found = value(name)
    if not found > 0:
        raise ModelError(f"effect {at.term.cause} on {at.term.axis}: {name} is {found}; it must be > 0")
    return found


_CAUSES: dict[str, Callable[[Laws, _Place, _Value], None]] = {
    "coulomb_friction": _coulomb,
    "viscous_friction": _viscous,
    "stribeck_friction": _stribeck,
    "presliding_friction": _presliding,
    "asymmetric_friction": _asymmetric,
    "torque_offset": _offset,
    "cogging": _cogging,
    "gravity": _gravity,
    "torque_saturation": _saturation,
    "torque_gain": _gain,
    "torque_delay": _delay,
    "torque_lag": _lag,
    "encoder_eccentricity": _eccentricity,
    "dropped_samples": _dropped,
    "spring_damping": _spring_damping,
    "cubic_stiffness": _cubic,
    "backlash": _backlash,
    "spring_hysteresis": _hysteresis,
    "transmission_error": _transmission,
    "extra_mode": _extra_mode,
    "coupling_stiffness": _coupling_stiffness,
    "payload_change": _payload,
    "parameter_drift": _drift,
}


def law_table(forces: list[ForceLaw]) -> tuple[Float64, Float64]:
    """(E, 3) law, a, b and (E, PARAMETERS) parameters for the kernel."""
    kinds = np.array([[f.law, f.a, f.b] for f in forces], dtype=float).reshape(-1, 3)
    parameters = np.zeros((len(forces), PARAMETERS))
    for row, force in zip(parameters, forces, strict=True):
        row[: len(force.parameters)] = force.parameters
    return kinds, parameters
