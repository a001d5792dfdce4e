"""Gauss and Newton's descent of a sum of squares too large for a matrix: each step by conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, Self, TypeVar

from scipy.sparse.linalg import LinearOperator, cg

from invid.numerics.arrays import Float64

STEPS, SHARES = 3, (1.0, 0.5, 0.25)
"""Most steps, and shares of one that are tried."""
ITERATIONS, TOLERANCE = 30, 1e-2
"""Most conjugate gradients of a step, and the share of its right side that they leave."""
LEFT = 0.3
"""What they leave of it at most: in scaled numbers the sum of squares falls by no more than its square."""
ARRIVED = 1e-3
"""Relative fall of the sum of squares below which the steps end: its own scatter is of that size."""


class Residual(Protocol):
    """Where a descent stands: the sum of squares there, a step from there to its linear minimum, and the
    residual a share of such a step on."""

    @property
    def cost(self) -> float:
        """The sum of squares."""

    def step(self) -> Float64:
        """A step in scaled numbers."""

    def moved(self, step: Float64) -> Self:
        """The residual after a step."""


R = TypeVar("R", bound=Residual)


def descend(now: R) -> R:
    """The residual where no step lowers the sum of squares by much."""
    for _ in range(STEPS):
        step = now.step()
        for share in SHARES:
            found = now.moved(share * step)
            if found.cost < now.cost:
                break
        else:
            break
        gained, now = now.cost - found.cost, found
        if gained < ARRIVED * now.cost:
            break
    return now


def solve_normal(normal: Callable[[Float64], Float64], right: Float64) -> Float64:
    """The solution of normal·x = right for an operator whose diagonal is about one."""
    operator = LinearOperator((right.size, right.size), matvec=normal, dtype=float)
    found: Float64 = cg(operator, right, rtol=TOLERANCE, atol=LEFT, maxiter=ITERATIONS)[0]
    return found
