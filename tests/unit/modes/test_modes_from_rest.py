"""Records from rest: the transient taken out, so that the paper's method works on them."""

from __future__ import annotations

import numpy as np
from scipy.signal import lsim

from invid.inverse import identify_paper
from invid.model.chains import CoupledChains
from invid.model.forward import frf
from invid.modes.settle import settled_frf
from invid.recording.model import Experiment, Kind, Role
from invid.signals.frf import FrfMatrix, local_frf_matrix
from invid.signals.spectra import LineSpectra, spectra_of

RATE, PERIOD, FINE = 200.0, 4.0, 5
LINES = np.arange(2, 36) / PERIOD


def from_rest(chains: CoupledChains, number: int, noise: float) -> LineSpectra:
    """Two periods of a multisine on a plant that was at rest, integrated by scipy."""
    rng = np.random.default_rng(7)
    phases = rng.uniform(0, 2 * np.pi, (2, LINES.size))
    phases[1] += np.pi * number  # orthogonal over the two experiments
    samples = round(2 * PERIOD * RATE)
    fine = np.arange(samples * FINE) / (RATE * FINE)
    torque = 2.0 * np.sin(2 * np.pi * LINES * fine[:, None, None] + phases).sum(axis=2)
    n = chains.dofs
    inverse = np.linalg.inv(chains.mass_matrix)
    state = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-inverse @ chains.stiffness_matrix, -inverse @ chains.damping_matrix],
        ]
    )
    push = np.zeros((2 * n, 2))
    push[n:] = inverse[:, chains.motor_dofs]
    read = np.zeros((2, 2 * n))
    read[[0, 1], chains.motor_dofs] = 1.0
    _, position, _ = lsim((state, push, read, np.zeros((2, 2))), torque, fine)
    position, torque = position[::FINE], torque[::FINE]
    chance = np.random.default_rng(number)
    experiment = Experiment(
        f"{number:03d}",
        Kind.MULTISINE,
        Role.IDENTIFY,
        -1,
        np.zeros(2),
        round(PERIOD * RATE),
        LINES,
        RATE,
        np.arange(samples) / RATE,
        position + noise * np.std(position, axis=0) * chance.standard_normal(position.shape),
        torque,
    )
    return spectra_of(experiment)


def plant() -> CoupledChains:
    return CoupledChains.build(
        [[1.0, 1.5], [2.0, 3.0]], [[800.0], [1500.0]], [[0.3], [0.5]], [[0, 0.6], [0.6, 0]]
    )


def error(found: FrfMatrix, truth: CoupledChains) -> float:
    """Median over lines of the relative error of the FRF matrix."""
    wanted = frf(truth, 2 * np.pi * found.frequency_hz)
    axes = (1, 2)
    return float(np.median(np.linalg.norm(found.frf - wanted, axis=axes) / np.linalg.norm(wanted, axis=axes)))


def test_the_frf_of_records_from_rest_is_that_of_the_plant_once_settled() -> None:
    truth = plant()
    spectra = [from_rest(truth, number, 1e-5) for number in range(2)]
    assert all(s.transient for s in spectra)
    blunted = local_frf_matrix(spectra)
    settled = settled_frf(spectra, (2, 2), blunted)
    assert error(settled, truth) < 0.01
    assert error(settled, truth) < 0.2 * error(blunted, truth)
    result = identify_paper(settled.frequency_hz, settled.frf, settled.variance, (2, 2))
    for mine, theirs in zip(
        result.chains.masses + result.chains.springs, truth.masses + truth.springs, strict=True
    ):
        np.testing.assert_allclose(mine, theirs, rtol=0.03)
    np.testing.assert_allclose(result.chains.couplings[0, 1], 0.6, rtol=0.05)
