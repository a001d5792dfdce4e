"""Levenberg–Marquardt: the loop of every nonlinear fit, the direction of a step apart from its length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64

LARGEST_STEP = 0.7
"""Largest step of a logarithm in one iteration (a factor of two): unguarded steps overflow."""
NEARLY = 0.3
"""Predicted decrease of χ², in units of χ²/ν, below which a search that can go no further has arrived:
half a standard deviation of one combination of parameters."""
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-12
"""Of parameters scaled to unit columns: at the start, and the least that is told from none."""
LESS, MORE, FROM = 1.0 / 8.0, 10.0, 1e-6
"""Factors of the damping after a step that went down and one that did not, and where the latter begins."""
LEAST_SHARE, MOST_SHARE = 0.02, 0.8
"""Shares of a step between which the minimum of the parabola through it is tried."""
TRIALS = 8
"""Dampings tried for one step: from the least to a hundred, a step of a hundredth of the gradient's."""


class HasCost(Protocol):
    """A point of the search."""

    @property
    def cost(self) -> float:
        """χ², or another sum of squares."""


Point = TypeVar("Point", bound=HasCost)


@dataclass(frozen=True, eq=False)
class Parabola:
    """The cost around a point by Gauss and Newton, along the principal axes of scaled parameters.

    For steps s (n,): cost + 2·gradient·s + sᵀ·normal·s.
    """

    gradient: Float64
    """(n,) of half the cost; zero for parameters that do not move."""
    move: Bool
    """(n,) which parameters move."""
    scale: Float64
    axes: Float64
    curvature: Float64
    slope: Float64

    @classmethod
    def of_normal(cls, normal: Float64, gradient: Float64, move: Bool | None = None) -> Parabola:
        """From a normal matrix (n, n) and the gradient (n,) of half the cost.

        Half of the digits are lost: for fits that start near their minimum, where a product is several times
        faster than the QR of as many rows.

        Raises
        ------
        LinAlgError
            They are not finite.
        """
        if move is None:
            move = np.ones(gradient.size, dtype=bool)
        scale = np.sqrt(np.maximum(np.diag(normal)[move], 0.0))
        scale[scale == 0] = 1.0
        scaled = normal[np.ix_(move, move)] / scale[:, None] / scale
        if not np.isfinite(scaled).all():
            raise np.linalg.LinAlgError("the normal equations are not finite")
        curvature, axes = np.linalg.eigh(scaled)
        curvature = np.maximum(curvature, 1e-14 * curvature.max(initial=1e-300))
        slope: Float64 = axes.T @ (gradient[move] / scale)
        return cls(np.where(move, gradient, 0.0), move, scale, axes, curvature, slope)

    @classmethod
    def of_rows(cls, jacobian: Float64, residual: Float64, move: Bool | None = None) -> Parabola:
        """From a Jacobian (rows, n) and a residual (rows,), with all digits that they have.

        Directions that the rows hardly show keep their sign and size, which a normal matrix loses at half of
        the digits: far from a minimum they would cut every step short.

        Raises
        ------
        LinAlgError
            They are not finite.
        """
        if move is None:
            move = np.ones(jacobian.shape[1], dtype=bool)
        moving = jacobian[:, move]
        scale = np.linalg.norm(moving, axis=0)
        scale[scale == 0] = 1.0
        if not np.isfinite(scale).all():
            raise np.linalg.LinAlgError("the Jacobian is not finite")
        stacked = np.column_stack((moving / scale, residual))
        triangle: Float64 = np.asarray(np.linalg.qr(stacked, mode="r"))
        n = int(move.sum())
        left, size, right = np.linalg.svd(triangle[:n, :n])
        seen = np.maximum(size, 1e-12 * size.max(initial=1e-300))
        gradient = np.zeros(move.size)
        gradient[move] = moving.T @ residual
        return cls(gradient, move, scale, right.T, seen**2, seen * (left.T @ triangle[:n, n]))

    @property
    def predicted(self) -> float:
        """Decrease of the cost that an undamped step would bring."""
        return float(self.slope @ (self.slope / self.curvature))

    def step(self, damping: float) -> Float64:
        """(n,) step with ``damping``."""
        out = np.zeros(self.move.size)
        out[self.move] = -(self.axes @ (self.slope / (self.curvature + damping))) / self.scale
        return out


@dataclass(frozen=True, eq=False)
class Minimum(Generic[Point]):
    """Where a search stopped.

    ``result`` is "converged", "stalled" (no step reduces the cost, gradient not small) or "limit" (iterations
    or time used up). ``predicted`` is the decrease of the cost that the last parabola promised.
    """

    point: Point
    result: str
    iterations: int
    predicted: float


def minimise(  # noqa: PLR0913 - a cost, and when to end
    start: Point,
    parabola: Callable[[Point], Parabola],
    moved: Callable[[Point, Float64, float], Point | None],
    *,
    limited: Bool | None = None,
    iterations: int = 60,
    dof: float = 1.0,
    tolerance: float = 0.0,
    gain: float = 0.0,
) -> Minimum[Point]:
    """The lowest cost from ``start``.

    Parameters
    ----------
    parabola
        The cost around a point; asked once for each accepted one.
    moved
        The point a step (n,) further, within its bounds; none where there is none, or where its cost is
        above the limit that comes third: how far above makes no difference then.
    limited
        (n,) parameters of which a step is no longer than ``LARGEST_STEP``: logarithms.
    dof, tolerance, gain
        Converged when the predicted decrease is below ``tolerance``, or the one made below ``gain``, times
        cost/``dof``. With χ² no parameter would then move by more than √tolerance standard deviations.
    """
    now, damping, predicted = start, FIRST_DAMPING, np.inf
    for iteration in range(iterations):
        if budget.is_left_out("fits to their end"):
            return Minimum(now, "limit", iteration, predicted)
        unit = max(now.cost / max(dof, 1.0), 1e-12)
        try:
            around = parabola(now)
        except np.linalg.LinAlgError:
            return Minimum(now, "stalled", iteration, np.inf)
        predicted = around.predicted
        if predicted < tolerance * unit:
            return Minimum(now, "converged", iteration, predicted)
        following: Point | None = None
        for _ in range(TRIALS):
            step = _within(around.step(damping), limited)
            following = _lower(now, 2.0 * float(around.gradient @ step), step, moved)
            if following is not None:
                break
            damping = max(damping, FROM) * MORE
        if following is None:
            result = "converged" if predicted < NEARLY * unit else "stalled"
            return Minimum(now, result, iteration, predicted)
        gained, now = now.cost - following.cost, following
        damping = max(damping * LESS, LEAST_DAMPING)
        if gained < gain * max(now.cost / max(dof, 1.0), 1e-12):
            return Minimum(now, "converged", iteration + 1, predicted)
    return Minimum(now, "limit", iterations, predicted)


def _within(step: Float64, limited: Bool | None) -> Float64:
    """The step, all of it shorter where a logarithm would move by more than ``LARGEST_STEP``."""
    largest = 0.0 if limited is None else float(np.abs(step[limited]).max(initial=0.0))
    return step * (LARGEST_STEP / largest) if largest > LARGEST_STEP else step


def _lower(
    now: Point, slope: float, step: Float64, moved: Callable[[Point, Float64, float], Point | None]
) -> Point | None:
    """The better of a full step and the minimum of the parabola through it, where that is much shorter; none
    where neither goes down. ``slope`` is of the cost along the step."""
    # Above the limit the minimum of the parabola is too near to be tried.
    full = moved(now, step, now.cost + abs(slope) * (0.5 / LEAST_SHARE - 1.0))
    if full is None or not np.isfinite(full.cost):
        return None
    best = full
    if full.cost > now.cost + 0.25 * slope:
        curvature = full.cost - now.cost - slope
        share = -slope / (2.0 * curvature) if curvature > 0 else 1.0
        shorter = moved(now, share * step, now.cost) if LEAST_SHARE < share < MOST_SHARE else None
        if shorter is not None and shorter.cost < full.cost:
            best = shorter
    return best if best.cost < now.cost else None
