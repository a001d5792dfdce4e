"""Laws that a search supposes: waves of resistance on the motion at a place, one a coefficient.

A law opposes: its force on the place is −Σ coefficient·wave. Shapes are logarithms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.effects.laws.slider import slide
from invid.numerics.arrays import Float64


@dataclass(frozen=True, eq=False)
class SpotMotion:
    """Motion at a place over time, each (k,): position and velocity along it, and the position of its motor
    side.

    Of a spring the position is its deflection. ``time`` is the recording's clock [s], ``torque`` the torque
    that acts there, of motors alone.
    """

    position: Float64
    velocity: Float64
    angle: Float64
    time: Float64
    torque: Float64 | None = None

    @cached_property
    def acceleration(self) -> Float64:
        """(k,) derivative of the velocity."""
        out: Float64 = np.gradient(self.velocity, self.time[1] - self.time[0])
        return out

    def every(self, count: int) -> SpotMotion:
        """Every ``count``-th instant."""
        torque = None if self.torque is None else self.torque[::count]
        parts = (self.position, self.velocity, self.angle, self.time)
        position, velocity, angle, time = (p[::count] for p in parts)
        return SpotMotion(position, velocity, angle, time, torque)


Shape = tuple[float, ...]


class SupposedLaw(ABC):
    """One law of the search."""

    cause: str
    main = "torque"
    """The parameter that its coefficient is."""
    at: str
    """Kind of place: "motor", "mass", "load" or "spring"."""
    low: tuple[float, ...] = (-np.inf,)
    least_axes = 1
    """Axes without which it is another number of the plant."""
    several = False
    """Whether it may stand at one place several times."""
    shape_step = 0.01
    """Step of a shape for its derivative."""
    coarse = False
    """Whether its waves are smooth enough for a coarser grid of time while it is only scored."""

    @abstractmethod
    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        """(k, L) resistance for each coefficient at one."""

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        """The contract's parameters; ``stiffness`` is that of the spring at its place."""
        return {self.main: float(coefficients[0])}

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        """Shapes to score."""
        return [()]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        """Bounds of each shape."""
        return []


def _extent(values: Sequence[Float64], share: float) -> float:
    return float(np.quantile(np.abs(np.concatenate(list(values))), share))


class Backlash(SupposedLaw):
    """Free play: a spring gives no force, and its damper none, while its deflection lies within ±gap/2.

    Its coefficients are the spring's own stiffness and damping, its shape is ln(gap).
    """

    cause, at, low = "backlash", "spring", (0.0, -np.inf)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        half = 0.5 * float(np.exp(shape[0]))
        inside = np.abs(motion.position) < half
        return np.stack((-np.clip(motion.position, -half, half), -motion.velocity * inside), axis=1)

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = 2.0 * _extent([m.position for m in motions], 0.995)
        return [(float(np.log(top * share)),) for share in (0.03, 0.06, 0.1, 0.16, 0.25, 0.4, 0.6)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        top = 2.0 * _extent([m.position for m in motions], 0.999)
        return [(float(np.log(1e-3 * top)), float(np.log(top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gap": float(np.exp(shape[0]))}


class CubicStiffness(SupposedLaw):
    """A spring that hardens (or softens) with the third power of its deflection."""

    cause, at = "cubic_stiffness", "spring"
    main = "coefficient"

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        cube: Float64 = (motion.position**3)[:, None]
        return cube


class Cogging(SupposedLaw):
    """A torque that is a sinusoid of the motor's position; shape ln(cycles)."""

    cause, at, low = "cogging", "motor", (-np.inf, -np.inf)
    several = coarse = True
    shape_step = 1e-3
    LEAST, MOST, PER_SPAN = 0.5, 400.0, 0.35

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn = float(np.exp(shape[0])) * motion.position
        return np.stack((np.sin(turn), np.cos(turn)), axis=1)

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        # Few cycles on a small motion are a spring to ground and a constant torque.
        span = _extent([m.position - m.position.mean() for m in motions], 0.98)
        step = max(self.PER_SPAN / span, 0.25)
        first = max(self.LEAST / span, 1.5)
        return [(float(np.log(n)),) for n in np.arange(first, max(self.MOST / 4, 12 * first), step)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        span = _extent([m.position - m.position.mean() for m in motions], 0.98)
        return [(float(np.log(self.LEAST / span)), float(np.log(2000.0)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        sine, cosine = coefficients
        return {
            "torque": float(np.hypot(sine, cosine)),
            "cycles_per_rev": float(np.exp(shape[0])),
            "phase": float(np.arctan2(cosine, sine)),
        }


class TransmissionError(SupposedLaw):
    """A sinusoid of the gear's angle in the deflection of its spring; shape ln(cycles)."""

    cause, at, low = "transmission_error", "spring", (-np.inf, -np.inf)
    coarse = True
    shape_step = 1e-3
    LEAST, MOST = 2.0, 120.0

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn = float(np.exp(shape[0])) * motion.angle
        return np.stack((np.sin(turn), np.cos(turn)), axis=1)

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        span = _extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(n)),) for n in np.arange(self.LEAST / span, self.MOST, max(0.35 / span, 0.25))]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        span = _extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(self.LEAST / span)), float(np.log(self.MOST)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        sine, cosine = coefficients
        return {
            "amplitude": float(np.hypot(sine, cosine)) / stiffness,
            "cycles_per_rev": float(np.exp(shape[0])),
            "phase": float(np.arctan2(cosine, sine)),
        }


class InnerViscous(SupposedLaw):
    """Viscous friction of a mass behind the motor."""

    cause, at, low = "viscous_friction", "mass", (0.0,)
    main = "coefficient"

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return motion.velocity[:, None]


class InnerDry(SupposedLaw):
    """Dry friction of a mass behind the motor; shape ln(width of its turn)."""

    cause, at, low = "coulomb_friction", "mass", (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        turn: Float64 = np.tanh(motion.velocity / np.exp(shape[0]))[:, None]
        return turn

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        size = _extent([m.velocity for m in motions], 0.7)
        return [(float(np.log(0.02 * size)),)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        size = _extent([m.velocity for m in motions], 0.7)
        return [(float(np.log(2e-3 * size)), float(np.log(0.3 * size)))]


class Slider(SupposedLaw):
    """A spring that slides at its limit, beside a spring or at a motor; shape ln(deflection at which it
    slides).

    The coefficient is the torque at which it slides.
    """

    low = (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        most = float(np.exp(shape[0]))
        return slide(motion.position, most, periodic=False)[:, None] / most

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        size = _extent([m.position - m.position.mean() for m in motions], 0.9)
        return [(float(np.log(size * share)),) for share in (0.03, 0.1, 0.3)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        size = _extent([m.position - m.position.mean() for m in motions], 0.9)
        return [(float(np.log(1e-3 * size)), float(np.log(size)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        torque = float(coefficients[0])
        return {"stiffness": torque / float(np.exp(shape[0])), "torque": torque}


class SpringHysteresis(Slider):
    """A slider beside a spring."""

    cause, at = "spring_hysteresis", "spring"


class PreslidingFriction(Slider):
    """Dry friction of a motor that yields elastically before it slides."""

    cause, at = "presliding_friction", "motor"


class TorqueSaturation(SupposedLaw):
    """Torque beyond a limit does not act; shape ln(limit). Its coefficient is one."""

    cause, at, low = "torque_saturation", "motor", (0.0,)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        limit = float(np.exp(shape[0]))
        torque = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return (torque - np.clip(torque, -limit, limit))[:, None]

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(top * share)),) for share in (0.5, 0.65, 0.8, 0.9)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        top = max(float(np.abs(m.torque).max()) for m in motions if m.torque is not None)
        return [(float(np.log(0.2 * top)), float(np.log(0.98 * top)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"limit": float(np.exp(shape[0]))}


class TorqueGain(SupposedLaw):
    """More or less torque acts than is recorded, by a share of it."""

    cause, at = "torque_gain", "motor"
    least_axes = 2

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        torque = np.zeros(motion.position.size) if motion.torque is None else motion.torque
        return -torque[:, None]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"gain": 1.0 + float(coefficients[0])}


class PayloadChange(SupposedLaw):
    """A mass that comes on at a load at a time [s] of the recording's clock; shape ln(time)."""

    cause, at = "payload_change", "load"
    shape_step = 2e-3

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        late = (motion.time - float(np.exp(shape[0]))) / (motion.time[1] - motion.time[0])
        force: Float64 = (motion.acceleration * np.clip(late + 0.5, 0.0, 1.0))[:, None]
        return force

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        first = max(m.time[0] for m in motions)
        last = min(m.time[-1] for m in motions)
        return [(float(np.log(first + (last - first) * share)),) for share in np.linspace(0.1, 0.9, 9)]

    def bounds(self, motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
        first = max(m.time[0] for m in motions)
        last = min(m.time[-1] for m in motions)
        span = last - first
        return [(float(np.log(first + 0.02 * span)), float(np.log(last - 0.02 * span)))]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"mass": float(coefficients[0]), "time": float(np.exp(shape[0]))}


SUPPOSED: tuple[SupposedLaw, ...] = (
    Backlash(),
    CubicStiffness(),
    Cogging(),
    TransmissionError(),
    SpringHysteresis(),
    PreslidingFriction(),
    TorqueSaturation(),
    TorqueGain(),
    PayloadChange(),
    InnerViscous(),
    InnerDry(),
)
