"""The forward model against dense linear algebra written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from invid.model.chains import CoupledChains
from invid.model.forward import condense, frf


def random_chains(rng: np.random.Generator, counts: list[int], *, damped: bool) -> CoupledChains:
    masses = [rng.uniform(0.5, 5.0, n) for n in counts]
    springs = [rng.uniform(500.0, 5000.0, n - 1) for n in counts]
    dampers = [rng.uniform(0.0, 3.0, n - 1) for n in counts] if damped else None
    ends = np.array([m[-1] for m in masses])
    raw = rng.uniform(-1, 1, (len(counts), len(counts)))
    couplings = np.triu(raw, 1) * np.sqrt(np.outer(ends, ends)) * 0.8 / max(len(counts) - 1, 1)
    return CoupledChains.build(masses, springs, dampers, couplings + couplings.T)


def dense(chains: CoupledChains, omega: float) -> np.ndarray:
    return chains.stiffness_matrix + 1j * omega * chains.damping_matrix - omega**2 * chains.mass_matrix


CASES = [
    [1],
    [2],
    [3],
    [7],
    [1, 1],
    [1, 2, 3],
    [3, 3, 3],
    [5, 1, 2, 4],
    [2, 2, 6, 1, 3, 1, 4, 5],
]


@pytest.mark.parametrize("counts", CASES, ids=str)
@pytest.mark.parametrize("damped", [False, True], ids=["undamped", "damped"])
def test_the_recursion_equals_a_dense_solve_to_1e_10(counts: list[int], damped: bool) -> None:
    rng = np.random.default_rng(len(counts) * 10 + damped)
    chains = random_chains(rng, counts, damped=damped)
    held = rng.uniform(0, 300, len(counts)), rng.uniform(0, 2, len(counts)) * damped
    chains = replace(chains, ground_springs=held[0], ground_dampers=held[1])
    omega = rng.uniform(0.5, 120.0, 60)
    got = condense(chains, omega)
    response = frf(chains, omega)
    motor = chains.motor_dofs
    inner = np.setdiff1d(np.arange(chains.dofs), motor)
    for f, w in enumerate(omega):
        full = dense(chains, w)
        motion = np.zeros((chains.dofs, chains.branches), dtype=complex)
        motion[motor] = np.eye(chains.branches)
        motion[inner] = -np.linalg.solve(full[np.ix_(inner, inner)], full[np.ix_(inner, motor)])
        stiffness = full[motor] @ motion
        assert np.abs(got.motion[f] - motion).max() <= 1e-10 * np.abs(motion).max()
        assert np.abs(got.stiffness[f] - stiffness).max() <= 1e-10 * np.abs(stiffness).max()
        receptance = np.linalg.inv(full)[np.ix_(motor, motor)]
        assert np.abs(response[f] - receptance).max() <= 1e-10 * np.abs(receptance).max()
