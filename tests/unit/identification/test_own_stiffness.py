"""Chains that follow a motor's own stiffness: drawn ones are found again, narrow modes too."""

from __future__ import annotations

import numpy as np
import pytest

from invid.identification.own_stiffness import follow
from invid.numerics.arrays import Float64


def stiffness(omega: Float64, mass: Float64, spring: Float64) -> Float64:
    """(F,) |Z| of a chain with a thousandth of each spring's stiffness as loss at 30 rad/s."""
    size = mass.size
    laplacian = np.diag(np.append(spring, 0.0) + np.insert(spring, 0, 0.0))
    laplacian -= np.diag(spring, 1) + np.diag(spring, -1)
    out = np.empty(omega.size)
    for k, w in enumerate(omega):
        dynamic = laplacian * (1 + 1e-3j * w / 30.0) - w**2 * np.diag(mass)
        unit = np.eye(size)[0]
        out[k] = abs(1.0 / (unit @ np.linalg.solve(dynamic, unit)))
    return out


@pytest.mark.parametrize("seed", range(5))
def test_a_drawn_chain_is_found_from_starts_about_it_though_a_few_lines_are_bent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    masses = int(rng.integers(2, 5))
    truth = np.concatenate((rng.uniform(2.0, 6.0, masses), rng.uniform(2000.0, 6000.0, masses - 1)))
    omega = np.linspace(4.0, 90.0, 60)
    size = stiffness(omega, truth[:masses], truth[masses:])
    size[rng.choice(60, 5, replace=False)] *= 1.3
    starts = truth * np.exp(0.15 * rng.standard_normal((30, truth.size)))
    found, loss = follow(omega, size, starts)
    assert found[np.argmin(loss)] == pytest.approx(truth, rel=0.03)
