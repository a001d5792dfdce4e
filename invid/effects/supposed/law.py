"""What a supposed law is: waves of resistance on the motion at a place, one a coefficient.

A law opposes: its force on the place is −Σ coefficient·wave. Shapes are logarithms where they are sizes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from invid.effects.effect import Effect
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class SpotMotion:
    """Motion at a place over time, each (k,): position and velocity along it, and the position of its motor
    side.

    Of a spring the position is its deflection. ``time`` is the recording's clock [s], which began at
    ``origin``; ``torque`` the torque that acts there, of motors alone; ``stiffness`` that of the spring at a
    place, where a fit has said it.
    """

    position: Float64
    velocity: Float64
    angle: Float64
    time: Float64
    torque: Float64 | None = None
    stiffness: float | None = None
    origin: float = 0.0

    @cached_property
    def acceleration(self) -> Float64:
        """(k,) derivative of the velocity."""
        out: Float64 = np.gradient(self.velocity, self.time[1] - self.time[0])
        return out

    def every(self, count: int) -> SpotMotion:
        """Every ``count``-th instant."""
        if count == 1:
            return self
        torque = None if self.torque is None else self.torque[::count]
        parts = (self.position, self.velocity, self.angle, self.time)
        position, velocity, angle, time = (p[::count] for p in parts)
        return replace(self, position=position, velocity=velocity, angle=angle, time=time, torque=torque)


Shape = tuple[float, ...]
Bounds = list[tuple[float, float]]


@dataclass(frozen=True)
class LawPlace:
    """What a law's parameters need of its place: its number in the chain, the stiffness of a spring there."""

    number: int
    stiffness: float = 1.0


class SupposedLaw(ABC):
    """One law of the search."""

    effect: Effect
    """The cause that it is the law of."""
    main: str = "torque"
    """The parameter that its coefficient is."""
    low: tuple[float, ...] = (-np.inf,)
    several = False
    """Whether it may stand at one place several times."""
    shape_step = 0.01
    """Largest step of a shape for its derivative."""
    coarse = False
    """Whether its waves are smooth enough for a coarser grid of time while it is only scored."""
    reads = False
    """Whether its waves are by how much its motor stands beyond its reading, and no force."""
    scales = False
    """Whether it multiplies the torque of its motor."""
    covers: frozenset[str] = frozenset()
    """Parts of the friction of its axis' motor that it takes the place of."""
    beside: tuple[str, ...] = ()
    """Parts of the friction of its axis' motor whose coefficients its parameters need, after its own."""
    contains: tuple[type[SupposedLaw], ...] = ()
    """Laws of the same place that it takes the place of."""

    @property
    def cause(self) -> str:
        """Name of the cause."""
        return self.effect.cause

    @abstractmethod
    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        """(k, L) resistance for each coefficient at one."""

    def places(self, chains: ChainStructure) -> list[Place]:
        """Where it may stand."""
        return self.effect.places(chains)

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        """Bounds of each coefficient."""
        return [(low, np.inf) for low in self.low]

    def parameters(self, coefficients: Float64, shape: Shape, place: LawPlace) -> dict[str, float]:
        """The contract's parameters."""
        return {self.main: float(coefficients[0])}

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        """Shapes to score."""
        return [()]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        """Bounds of each shape."""
        return []


def extent(values: Sequence[Float64], share: float) -> float:
    """Size that a share of all values stays below."""
    return float(np.quantile(np.abs(np.concatenate(list(values))), share))


def travel(motions: Sequence[SpotMotion]) -> float:
    """Size that the position's distance from its mean stays below, but for a fiftieth of the time."""
    return extent([m.position - m.position.mean() for m in motions], 0.98)


def sinusoid(position: Float64, cycles: float) -> Float64:
    """(k, 2) sine and cosine of so many cycles a revolution."""
    return np.stack((np.sin(cycles * position), np.cos(cycles * position)), axis=1)


def amplitude_and_phase(coefficients: Float64) -> tuple[float, float]:
    """Of sine·sin(x) + cosine·cos(x) as amplitude·sin(x + phase)."""
    sine, cosine = coefficients[:2]
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))
