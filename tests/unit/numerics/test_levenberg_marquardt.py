"""The loop of every nonlinear fit, on problems whose minimum is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from invid.numerics.arrays import Float64
from invid.numerics.levenberg_marquardt import Minimum, Parabola, minimise


@dataclass(frozen=True, eq=False)
class Valley:
    """Rosenbrock's: 10·(y − x²) and 1 − x are zero at (1, 1)."""

    x: Float64

    @property
    def residual(self) -> Float64:
        return np.array([10.0 * (self.x[1] - self.x[0] ** 2), 1.0 - self.x[0]])

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def parabola(self) -> Parabola:
        jacobian = np.array([[-20.0 * self.x[0], 10.0], [-1.0, 0.0]])
        return Parabola.of_rows(jacobian, self.residual)


def searched(limited: bool = False, tolerance: float = 1e-12) -> tuple[Minimum[Valley], list[Float64]]:
    steps: list[Float64] = []

    def moved(here: Valley, step: Float64, _: float) -> Valley:
        steps.append(step)
        return Valley(here.x + step)

    found = minimise(
        Valley(np.array([-1.2, 1.0])),
        lambda here: here.parabola,
        moved,
        limited=np.array([limited, False]),
        tolerance=tolerance,
    )
    return found, steps


def test_a_bent_valley_is_followed_to_its_end() -> None:
    found, _ = searched()
    assert found.result == "converged"
    assert found.point.x == pytest.approx([1.0, 1.0], abs=1e-6)


def test_a_search_that_finds_no_plant_says_that_it_stalled() -> None:
    found = minimise(Valley(np.array([-1.2, 1.0])), lambda here: here.parabola, lambda here, step, _: None)
    assert found.result == "stalled"
    assert found.iterations == 0


def test_a_parabola_that_is_not_finite_ends_the_search_and_not_the_program() -> None:
    def lost(here: Valley) -> Parabola:
        return Parabola.of_rows(np.full((2, 2), np.nan), here.residual)

    found = minimise(Valley(np.array([-1.2, 1.0])), lost, lambda here, step, _: Valley(here.x + step))
    assert found.result == "stalled"
