"""What every cause of the catalogue declares, and the places it can sit at.

A cause adds a *resisting* force at a coordinate (or between two), seen by the motors as
ZΘ − T + Wᵀ b f = 0; or it changes the torque or position that is recorded (``direct``). Its force is
linear in ``coefficients`` for a given ``shape`` (a velocity, a reach, a gap, a frequency).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from invid.arrays import Complex128, Float64
from invid.effects.motion import Context as Context
from invid.effects.motion import RecordMotion as RecordMotion
from invid.refine.structure import ChainStructure

Shape = tuple[float, ...]


@dataclass(frozen=True)
class Place:
    """Where a cause sits: ``a`` a coordinate, ``b`` the other end of a spring or coupling."""

    axis: int
    element: str | None
    a: int
    b: int | None = None
    spring: int = -1
    other: int | None = None

    @property
    def inner(self) -> bool:
        """Whether a force here moves coordinates that are not measured."""
        return self.b is not None or (self.element is not None and self.element not in ("mass 1",))


class Family(StrEnum):
    """Causes that look alike in some records, and stay alternatives where they do."""

    FRICTION = "friction"
    STATIC = "static"
    POSITION = "position"
    ACTUATOR = "actuator"
    SENSOR = "sensor"
    SPRING = "spring"
    STRUCTURE = "structure"
    TIME = "time"


Force = Callable[[Context, RecordMotion, Place, Shape], Complex128]
"""(F, L) resisting force per unit of each coefficient, or (F, M, L) for ``direct``."""


def no_shape(_context: Context, _place: Place) -> list[Shape]:
    """The grid of a cause without shape parameters."""
    return [()]


def not_static(_c: Float64, _shape: Shape, _v: float) -> float:
    """A cause without a steady torque at constant velocity."""
    return 0.0


@dataclass(frozen=True, eq=False)
class Effect:
    """One cause.

    Attributes
    ----------
    places
        All places of a structure it can sit at.
    force, direct
        One of the two: its columns on the lines.
    parameters
        (coefficients, shape) -> contract parameters.
    units
        Unit kind of each parameter: torque, damping, stiffness, inertia, position, velocity, time,
        angle, cubic, one.
    grid
        Start values of the shape; the first ``variants`` entries are discrete.
    lower
        Physical lower bounds of the coefficients (empty: none).
    unit_coefficient
        The coefficient is 1 by definition; the size is in the shape.
    nested
        Simpler causes that are special cases: preferred when they do as well.
    static
        Steady resisting torque at constant velocity v, (coefficients, shape, v).
    """

    cause: str
    family: Family
    places: Callable[[ChainStructure], tuple[Place, ...]]
    parameters: Callable[[Float64, Shape], dict[str, float]]
    units: Mapping[str, str]
    check: str
    force: Force | None = None
    direct: Force | None = None
    grid: Callable[[Context, Place], list[Shape]] = no_shape
    variants: int = 0
    lower: tuple[float, ...] = ()
    unit_coefficient: bool = False
    nested: tuple[str, ...] = ()
    words: str = ""
    within: Callable[[Context, Place, Shape], bool] = field(default=lambda _c, _p, _s: True)
    static: Callable[[Float64, Shape, float], float] = not_static

    def columns(self, context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
        """(F, M, L) contribution to the missing torque per unit of each coefficient."""
        if self.direct is not None:
            return self.direct(context, record, place, shape)
        forces = self.forces(context, record, place, shape)
        return np.stack([record.seen(forces[:, k], place.a, place.b) for k in range(forces.shape[1])], axis=2)

    def forces(self, context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
        """(F, L) resisting force per unit; (F, 0) for causes that are no force."""
        if self.force is None:
            return np.zeros((record.index.size, 0), dtype=complex)
        return self.force(context, record, place, shape)


# --- places ----------------------------------------------------------------------------------------
def every_mass(s: ChainStructure) -> tuple[Place, ...]:
    """All masses of all branches."""
    return tuple(
        Place(i, f"mass {q + 1}", s.motor_dofs[i] + q) for i in range(s.motors) for q in range(s.sizes[i])
    )


def every_motor(s: ChainStructure) -> tuple[Place, ...]:
    """The first mass of each branch."""
    return tuple(Place(i, "mass 1", s.motor_dofs[i]) for i in range(s.motors))


def every_axis(s: ChainStructure) -> tuple[Place, ...]:
    """Each axis, no element: actuator and sensor."""
    return tuple(Place(i, None, s.motor_dofs[i]) for i in range(s.motors))


def every_end(s: ChainStructure) -> tuple[Place, ...]:
    """The last mass of each branch."""
    return tuple(Place(i, f"mass {s.sizes[i]}", s.end_dofs[i]) for i in range(s.motors))


def every_spring(s: ChainStructure) -> tuple[Place, ...]:
    """All springs of all branches."""
    out = []
    for number, (a, b) in enumerate(s.spring_pairs):
        axis = max(i for i in range(s.motors) if s.motor_dofs[i] <= a)
        out.append(Place(axis, f"spring {a - s.motor_dofs[axis] + 1}", a, b, number))
    return tuple(out)


def every_pair(s: ChainStructure) -> tuple[Place, ...]:
    """The last masses of every pair of branches."""
    return tuple(
        Place(i, f"mass {s.sizes[i]}", s.end_dofs[i], s.end_dofs[j], other=j) for i, j in s.coupling_pairs
    )


# --- pieces that several laws use ------------------------------------------------------------------
def direction(record: RecordMotion, place: Place) -> Float64:
    """(n,) sign of the velocity, smooth where the velocity is within its noise."""
    v = record.velocity[:, place.a]
    # Two standard deviations of velocity noise: below them the sign is not known.
    width = max(2.0 * record.velocity_noise(place.axis), 2e-3 * float(np.sqrt(np.mean(v**2))), 1e-12)
    result: Float64 = np.tanh(v / width)
    return result


def on_torque(record: RecordMotion, axis: int, spectrum: Complex128) -> Complex128:
    """(F, M, 1) a column on one axis' torque."""
    out = np.zeros((record.index.size, record.torque.shape[1], 1), dtype=complex)
    out[:, axis, 0] = spectrum
    return out


def velocity_grid(context: Context, place: Place) -> list[Shape]:
    """Stribeck velocities from a twentieth of the rms velocity to all of it; both laws."""
    v = context.velocity_rms(place.a)
    return [(kind, v * f) for kind in (0.0, 1.0) for f in (0.05, 0.15, 0.4, 1.0)]


def reach_grid(context: Context, place: Place) -> list[Shape]:
    """Presliding lengths from a hundredth to a quarter of the motion; both laws."""
    s = context.span(place.a, place.b)
    return [(kind, s * f) for kind in (0.0, 1.0) for f in (0.01, 0.03, 0.1, 0.25)]


def cycles_grid(context: Context, place: Place) -> list[Shape]:
    """Cycles a revolution that the motion can tell apart: 1.5 to 60 rad of phase over its span.

    Below, a ripple is a constant and a spring; the step is half the width of a peak.
    """
    s = context.span(place.a)
    return [(float(n),) for n in np.arange(1.5, 60.0, 1.25) / s]


def polar(c: Float64, amplitude: str, phase: str) -> dict[str, float]:
    """Amplitude and phase of c₀ sin x + c₁ cos x = A sin(x + φ)."""
    return {amplitude: float(np.hypot(c[0], c[1])), phase: float(np.arctan2(c[1], c[0]))}
