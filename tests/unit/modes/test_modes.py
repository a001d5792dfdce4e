"""Poles and zeros from noisy FRF matrices, and the paper's inverse on them, truth unseen."""

from __future__ import annotations

import numpy as np

from invid.inverse import identify_paper
from invid.model.chains import CoupledChains, case_study


def measured(
    chains: CoupledChains,
    *,
    noise: float = 0.005,
    seed: int = 0,
    lines: int = 300,
    top: float = 10.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, receptance with torque and encoder noise, its variance; dense algebra, no recursion."""
    rng = np.random.default_rng(seed)
    frequency = np.linspace(0.5, top, lines)
    motor, count = chains.motor_dofs, chains.branches
    g = np.empty((lines, count, count), dtype=complex)
    for k, w in enumerate(2 * np.pi * frequency):
        full = chains.stiffness_matrix + 1j * w * chains.damping_matrix - w**2 * chains.mass_matrix
        g[k] = np.linalg.inv(full)[np.ix_(motor, motor)]

    def random() -> np.ndarray:
        return (rng.standard_normal(g.shape) + 1j * rng.standard_normal(g.shape)) / np.sqrt(2)

    encoder = 0.3 * noise * np.median(np.abs(g))
    variance = noise**2 * np.sum(np.abs(g) ** 2, axis=2, keepdims=True) + encoder**2
    noisy = g + noise * (g @ random()) + encoder * random()
    return frequency, noisy, np.broadcast_to(variance, g.shape).copy()


def largest_error(found: CoupledChains, truth: CoupledChains) -> float:
    errors = [
        np.max(np.abs(a / b - 1))
        for a, b in zip(found.masses + found.springs, truth.masses + truth.springs, strict=True)
        if b.size
    ]
    scale = max(float(np.abs(truth.couplings).max()), 0.5)
    return float(max([*errors, np.abs(found.couplings - truth.couplings).max() / scale]))


def test_the_case_study_is_identified_within_one_per_cent_at_half_a_per_cent_noise() -> None:
    truth = case_study(damping_ratio=0.01)
    result = identify_paper(*measured(truth), (3, 3, 3))
    assert largest_error(result.chains, truth) < 0.01
    assert result.warnings == ()
    dampers = np.concatenate(result.chains.dampers) / np.concatenate(truth.dampers)
    assert np.all((dampers > 0.7) & (dampers < 1.4))


def test_modes_of_equal_branches_share_their_poles() -> None:
    truth = CoupledChains.build([[1.0, 2.0, 3.0]] * 2, [[1000.0, 2000.0]] * 2)
    assert largest_error(identify_paper(*measured(truth), (3, 3)).chains, truth) < 0.01
