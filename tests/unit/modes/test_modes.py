"""Poles and zeros from noisy FRF matrices, and the paper's inverse on them, truth unseen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from invid.errors import InputError, NotIdentifiableError
from invid.inverse import identify_paper
from invid.model.chains import CoupledChains, case_study
from invid.model.forward import natural_frequencies
from invid.modes import fit_modes


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


def test_a_pole_zero_pair_a_ten_thousandth_apart_is_found_in_its_branch() -> None:
    truth = case_study(damping_ratio=0.005)  # branch 2: 51.27 and 51.28 rad/s
    modes = fit_modes(*measured(truth, noise=0.002), (3, 3, 3))
    found, _ = modes.zeros(1)
    kept = np.delete(np.arange(9), truth.motor_dofs[1])
    at = np.ix_(kept, kept)
    locked = natural_frequencies(truth.mass_matrix[at], truth.stiffness_matrix[at])
    gap = (modes.omega[-1] - found[-1]) / found[-1]
    assert gap == pytest.approx((51.2801 - locked[-1]) / 51.28, rel=0.3)


def test_the_case_study_is_identified_within_one_per_cent_at_half_a_per_cent_noise() -> None:
    truth = case_study(damping_ratio=0.01)
    result = identify_paper(*measured(truth), (3, 3, 3))
    assert largest_error(result.chains, truth) < 0.01
    assert result.warnings == ()
    dampers = np.concatenate(result.chains.dampers) / np.concatenate(truth.dampers)
    assert np.all((dampers > 0.7) & (dampers < 1.4))


@pytest.mark.campaign
def test_deviations_of_the_paper_method_hold() -> None:
    truth = case_study(damping_ratio=0.002)
    upper = np.triu_indices(3, 1)
    wanted = np.concatenate(
        [np.concatenate((m, k)) for m, k in zip(truth.masses, truth.springs, strict=True)]
        + [truth.couplings[upper]]
    )
    scores = []
    for seed in range(4):
        result = identify_paper(*measured(truth, seed=seed), (3, 3, 3))
        chains = result.chains
        found = np.concatenate(
            [np.concatenate((m, k)) for m, k in zip(chains.masses, chains.springs, strict=True)]
            + [chains.couplings[upper]]
        )
        scores.append((found - wanted) / np.sqrt(np.diag(result.covariance)))
    assert 0.6 < float(np.sqrt(np.mean(np.square(scores)))) < 1.6


@pytest.mark.campaign
@pytest.mark.parametrize("sign", [-1.0, 0.0])
def test_couplings_are_found_with_their_sign_and_when_there_are_none(sign: float) -> None:
    plain = case_study(damping_ratio=0.01)
    truth = dataclasses.replace(plain, couplings=sign * plain.couplings)
    result = identify_paper(*measured(truth), (3, 3, 3))
    assert largest_error(result.chains, truth) < 0.05


def test_branches_of_one_two_and_three_masses_are_identified_together() -> None:
    truth = CoupledChains.build(
        [[2.0], [1.0, 2.0], [1.0, 1.5, 3.0]],
        [[], [900.0], [1200.0, 2000.0]],
        [[], [0.6], [0.5, 0.7]],
        [[0, 0.5, 0.4], [0.5, 0, 0.6], [0.4, 0.6, 0]],
    )
    result = identify_paper(*measured(truth, top=12.0), (1, 2, 3))
    assert largest_error(result.chains, truth) < 0.02


def test_a_single_free_mass_needs_no_mode() -> None:
    truth = CoupledChains.build([[2.0]], [[]])
    result = identify_paper(*measured(truth), (1,))
    assert result.chains.masses[0][0] == pytest.approx(2.0, rel=0.01)


def test_too_few_lines_are_refused_with_the_number_needed() -> None:
    frequency, g, variance = measured(case_study(damping_ratio=0.01), lines=8)
    with pytest.raises(NotIdentifiableError, match="8 usable lines for 6 modes"):
        fit_modes(frequency, g, variance, (3, 3, 3))


def test_shapes_that_do_not_fit_are_named() -> None:
    frequency, g, variance = measured(case_study(damping_ratio=0.01), lines=20)
    with pytest.raises(InputError, match="FRF of shape"):
        fit_modes(frequency, g[:, :2, :2], variance, (3, 3, 3))
    with pytest.raises(InputError, match="variance"):
        fit_modes(frequency, g, variance[:, :2], (3, 3, 3))


@pytest.mark.campaign
def test_resonances_above_the_band_are_warned_of() -> None:
    truth = case_study(damping_ratio=0.01)
    result = identify_paper(*measured(truth, lines=200, top=7.8), (3, 3, 3))
    assert any("1 of 6 resonances lie above the measured band" in w for w in result.warnings)
    assert largest_error(result.chains, truth) < 0.02
