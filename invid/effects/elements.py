"""Elements of the simulation that effects consist of, at coordinates, known to both simulators.

An effect says in ``Effect.simulation`` which elements it is. Force laws that are a table of one quantity
(``StaticLaw``) need nothing else; laws that stick or remember name a ``Law`` of the compiled kernels.
Signs: θ is the position of a mass, d = q_a − q_b the deflection between two (motor side minus load side).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

from invid.errors import ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64


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
    TABLE = 9  # [0 of position, 1 of velocity, 2 of both; largest position, largest velocity in it; its row]


@dataclass(frozen=True)
class ForceLaw:
    """One law of the kernel at its place: coordinates ``a`` and, for pairs, ``b`` (−1: none)."""

    law: Law
    a: int
    b: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class StaticLaw:
    """A resistance that is a function of position, velocity or both at its place, (n,) to (n,) [N·m or N].

    Between two coordinates (``b`` ≥ 0) the quantity is that of a minus that of b. The simulators read it from
    a table over twice the range of the motion, linearly extrapolated.
    """

    over: Literal["position", "velocity", "both"]
    force: Callable[..., Float64]
    a: int
    b: int = -1


@dataclass(frozen=True)
class AddedSpring:
    """A spring between a and b; b = −1: to ground."""

    a: int
    b: int
    stiffness: float


@dataclass(frozen=True)
class AddedDamper:
    """A damper between a and b; b = −1: to ground."""

    a: int
    b: int
    coefficient: float


@dataclass(frozen=True)
class AddedMass:
    """A mass on a spring at a coordinate, with its damping ratio."""

    at: int
    mass: float
    stiffness: float
    damping_ratio: float


@dataclass(frozen=True)
class AddedBase:
    """The body under all loads on a spring to ground, with all that stands on it as its ``mass``.

    ``force`` (M,) is what each load feels per acceleration of the body, ``shares`` (M,) how far it moves with
    it.
    """

    mass: float
    stiffness: float
    damper: float
    force: tuple[float, ...]
    shares: tuple[float, ...]


@dataclass(frozen=True)
class TorqueChannel:
    """Path of an axis' torque before it acts: gain, delay [s], lag [s], limit [N·m or N]."""

    axis: int
    gain: float = 1.0
    delay: float = 0.0
    lag: float | None = None
    limit: float | None = None


@dataclass(frozen=True)
class ReadingError:
    """An encoder whose reading is θ + amplitude·sin(θ + phase)."""

    axis: int
    amplitude: float
    phase: float


@dataclass(frozen=True)
class RepeatedRows:
    """Rows of the output that repeat the one before, with this probability."""

    fraction: float


@dataclass(frozen=True)
class LaterMass:
    """A mass added to a coordinate from a time on (the recording's clock) [s]."""

    at: int
    mass: float
    time: float


@dataclass(frozen=True)
class Drift:
    """A spring between a and b (b = −1: a mass) that changes by a rate a second."""

    a: int
    b: int
    rate: float


@dataclass(frozen=True)
class GroundSpring:
    """A resistance coefficient·q^power of a rigid axis to ground."""

    axis: int
    power: int
    coefficient: float


@dataclass(frozen=True)
class CarriedWeight:
    """A weight on the second of two rigid links, felt on both: sine·sin(q₁ + q₂) + cosine·cos(q₁ + q₂)."""

    sine: float
    cosine: float


@dataclass(frozen=True)
class LoadFriction:
    """Dry friction of a rigid axis, coefficient·|load|; ``inertia``: whether inertia counts as load."""

    axis: int
    coefficient: float
    inertia: float


Element = (
    ForceLaw
    | StaticLaw
    | AddedSpring
    | AddedDamper
    | AddedMass
    | AddedBase
    | TorqueChannel
    | ReadingError
    | RepeatedRows
    | LaterMass
    | Drift
    | GroundSpring
    | CarriedWeight
    | LoadFriction
)


class ModelPlace:
    """Place of an effect of a model in coordinates of its chains; ModelError where there is no such place.

    ``value(name)`` is a parameter of the effect. In a ``rigid`` model an axis is one mass, and its springs
    lead to ground.
    """

    def __init__(self, chains: CoupledChains, term: EffectTerm, *, rigid: bool = False) -> None:
        self.chains, self.term, self.rigid = chains, term, rigid
        self.value = term.value
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
        """Coordinate of the mass."""
        size = self.chains.masses[self.axis].size
        q = self._number("mass", default)
        if q > size:
            raise ModelError(f"effect {self.term.cause} on {self.term.axis}: mass {q} of {size}")
        return int(self.chains.motor_dofs[self.axis]) + q - 1

    def spring(self) -> tuple[int, int, float, float]:
        """Coordinates beside the spring, its stiffness and its damper."""
        springs = self.chains.springs[self.axis]
        s = self._number("spring", 1)
        if s > springs.size:
            raise ModelError(f"effect {self.term.cause} on {self.term.axis}: spring {s} of {springs.size}")
        a = int(self.chains.motor_dofs[self.axis]) + s - 1
        return a, a + 1, float(springs[s - 1]), float(self.chains.dampers[self.axis][s - 1])

    def coordinates(self, home: str) -> tuple[int, int]:
        """Where a force along the place acts: a and b, b = −1 to ground; ``home`` where none is said."""
        other, axes = self.term.other_axis, self.chains.axes
        if other is not None:
            if other not in axes:
                raise ModelError(
                    f"effect {self.term.cause} on {self.term.axis}: no other axis {other!r} in {list(axes)}"
                )
            ends = self.chains.end_dofs
            return int(ends[self.axis]), int(ends[axes.index(other)])
        kind = (self.term.element or ("spring" if home == "spring" else "mass")).partition(" ")[0]
        if kind == "spring":
            a, b, _, _ = self.spring()
            return a, b
        return self.mass(self.last if home == "end" else 1), -1

    @property
    def last(self) -> int:
        """Number of the final mass of the axis."""
        return int(self.chains.masses[self.axis].size)

    def positive(self, name: str) -> float:
        """A parameter; ModelError where it is not above zero."""
        found = self.value(name)
        if not found > 0:
            raise ModelError(
                f"effect {self.term.cause} on {self.term.axis}: {name} is {found}; it must be > 0"
            )
        return found

    def optional(self, name: str, default: float) -> float:
        """A parameter, or the default where the model does not state it."""
        given = self.term.parameters.get(name)
        return default if given is None else given.value


def dry_parameters(
    level: float, excess: float = 0.0, velocity: float = 1.0, exponent: float = 2.0
) -> tuple[float, ...]:
    """Parameters of ``Law.DRY``, the same in both directions."""
    return (level, level, excess, velocity, excess, exponent)
