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
from invid.model.place import Place
from invid.model.plant import Structure
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class SpotMotion:
    """Motion at a place over time, each (k,): position and velocity along it, and the position of its motor
    side.

    Of a spring the position is its deflection. ``time`` is the recording's clock [s], which began at
    ``origin``; ``torque`` the torque that acts there, of motors alone; ``own`` the stiffness of the spring
    or the mass at the place, where a fit has said it. ``repeats``: of several periods that are seen as their
    mean, so that what changes from one to the next is not seen.
    """

    position: Float64
    velocity: Float64
    angle: Float64
    time: Float64
    torque: Float64 | None = None
    own: float | None = None
    origin: float = 0.0
    repeats: bool = False

    @cached_property
    def fastest(self) -> float:
        """Largest change of the angle from one instant to the next."""
        return float(np.abs(np.diff(self.angle)).max())

    @cached_property
    def acceleration(self) -> Float64:
        """(k,) derivative of the velocity, by differences of the fourth order but for the ends.

        Those of the second err by a few ten thousandths, which beside a mass would be a force of its own.
        """
        v, step = self.velocity, self.time[1] - self.time[0]
        out: Float64 = np.gradient(v, step)
        out[2:-2] = (8.0 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12.0 * step)
        return out

    def every(self, count: int) -> SpotMotion:
        """Every ``count``-th instant."""
        if count == 1:
            return self
        torque = None if self.torque is None else self.torque[::count]
        parts = (self.position, self.velocity, self.angle, self.time)
        position, velocity, angle, time = (p[::count] for p in parts)
        return replace(self, position=position, velocity=velocity, angle=angle, time=time, torque=torque)


SMOOTH, TURN = 16, 0.7
"""Instants of the grid of motion that are a tenth of the highest excited period, and the phase of a ripple
[rad] that is a ninth of its own."""

Shape = tuple[float, ...]
Bounds = list[tuple[float, float]]


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
    reads = False
    """Whether its waves are by how much its motor stands beyond its reading, and no force."""
    scales = False
    """Whether it multiplies the torque of its motor, and has no wave of its own."""
    is_smooth = False
    """Whether its waves on as few instants as ``stride`` says serve a fit as well as a score."""
    covers: frozenset[str] = frozenset()
    """Parts of the friction of its axis' motor that it takes the place of."""
    beside: tuple[str, ...] = ()
    """Parts of the friction of its axis' motor whose coefficients its parameters need, after its own."""
    counts: str = ""
    """The parameter that is the number of its place, where one is."""
    contains: tuple[type[SupposedLaw], ...] = ()
    """Laws of the same place that it takes the place of."""

    @property
    def cause(self) -> str:
        """Name of the cause."""
        return self.effect.cause

    @abstractmethod
    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        """(k, L) resistance for each coefficient at one."""

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        """Most instants between two of a grid of time on which its waves are smooth."""
        return 1

    def places(self, chains: Structure) -> list[Place]:
        """Where it may stand."""
        return self.effect.places(chains)

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        """Bounds of each coefficient."""
        return [(low, np.inf) for low in self.low]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        """The contract's parameters; ``stiffness`` is that of the spring at its place."""
        return {self.main: float(coefficients[0])}

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        """Shapes to score."""
        return [()]

    def about(self, motions: Sequence[SpotMotion]) -> list[list[Shape]]:
        """Moves of a shape to look at, one grid finer than the other, where its slope says little of where
        the best one is."""
        return []

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        """Bounds of each shape."""
        return []


class AtMotor(SupposedLaw):
    """A law of motors."""

    def places(self, chains: Structure) -> list[Place]:
        return [p for p in self.effect.places(chains) if p.number == 1]


class InnerLaw(SupposedLaw):
    """A law of masses behind motors."""

    def places(self, chains: Structure) -> list[Place]:
        return [p for p in self.effect.places(chains) if p.number > 1]


def extent(values: Sequence[Float64], share: float) -> float:
    """Size that a share of all values stays below."""
    return float(np.quantile(np.abs(np.concatenate(list(values))), share))


def travel(motions: Sequence[SpotMotion]) -> float:
    """Size that the position's distance from its mean stays below, but for a fiftieth of the time."""
    return extent([m.position - m.position.mean() for m in motions], 0.98)


class SinusoidLaw(SupposedLaw):
    """A sinusoid of position, of one cycle a revolution or as many as the exponential of its shape.

    Of sine·sin(x) + cosine·cos(x) the parameters are those of main·sin(x + phase).
    """

    low = (-np.inf, -np.inf)
    phase = "phase"

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        """Instants within which the sinusoid turns by ``TURN``, ``SMOOTH`` at most."""
        return int(np.clip(TURN / (float(np.exp(sum(shape))) * max(motion.fastest, 1e-300)), 1, SMOOTH))

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return self.sinusoid(motion.position, shape)

    @staticmethod
    def sinusoid(position: Float64, shape: Shape) -> Float64:
        """(k, 2) sine and cosine."""
        turned = float(np.exp(sum(shape))) * position
        return np.stack((np.sin(turned), np.cos(turned)), axis=1)

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        sine, cosine = (float(c) for c in coefficients[:2])
        cycles = dict(zip(("cycles_per_rev",), np.exp(shape).tolist(), strict=False))
        return {
            self.main: float(np.hypot(sine, cosine)),
            **cycles,
            self.phase: float(np.arctan2(cosine, sine)),
        }
