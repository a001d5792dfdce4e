"""The missing-torque engine: derivatives, cost, boundary terms, convergence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from invid.identification.identifiability import blind_directions
from invid.likelihood.levenberg_marquardt import gauss_newton
from invid.likelihood.nuisance.torque_channel import Block
from invid.likelihood.records import problem_from_spectra
from invid.likelihood.residual import MissingTorqueProblem, condense_dense
from invid.model.chains import CoupledChains, case_study
from invid.model.document import parameter_vector
from invid.model.parameters import ChainStructure, structure_of
from invid.recording.model import Experiment, Kind, Role
from invid.signals.spectra import spectra_of


def random_chains(rng: np.random.Generator, sizes: tuple[int, ...]) -> CoupledChains:
    masses = [rng.uniform(0.5, 2.0, n) for n in sizes]
    count = len(sizes)
    couplings = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1, count):
            couplings[i, j] = couplings[j, i] = rng.uniform(-0.1, 0.1)
    return CoupledChains.build(
        masses,
        [rng.uniform(500, 3000, n - 1) for n in sizes],
        [rng.uniform(0.5, 2.0, n - 1) for n in sizes],
        couplings,
        ground_dampers=rng.uniform(0.1, 0.5, count),
    )


def full_frf(chains: CoupledChains, omega: np.ndarray) -> np.ndarray:
    out = []
    for w in omega:
        full = chains.stiffness_matrix + 1j * w * chains.damping_matrix - w**2 * chains.mass_matrix
        out.append(np.linalg.inv(full)[np.ix_(chains.motor_dofs, chains.motor_dofs)])
    return np.array(out)


def problem_of(
    chains: CoupledChains,
    rng: np.random.Generator,
    *,
    noise: float = 1e-4,
    transient: bool = False,
    lines: int = 40,
    delay: float = 0.0,
) -> MissingTorqueProblem:
    """One block an axis; measured = true + circular noise of the power given to the fit."""
    omega = np.linspace(3.0, 90.0, lines)
    frf = full_frf(chains, omega)
    count = chains.branches
    blocks = []
    for number in range(count):
        torque = rng.standard_normal((lines, count)) + 1j * rng.standard_normal((lines, count))
        acting = torque * np.exp(-1j * omega * delay)[:, None]
        position = np.einsum("fij,fj->fi", frf, acting)
        level = np.concatenate((np.full(count, noise * np.abs(position).mean()), np.full(count, noise)))
        both = (
            rng.standard_normal((lines, 2 * count)) + 1j * rng.standard_normal((lines, 2 * count))
        ) / np.sqrt(2)
        blocks.append(
            Block(
                key=f"{number:03d}",
                omega=omega,
                position=position + both[:, :count] * level[:count],
                torque=torque + both[:, count:] * level[count:],
                noise=np.tile(level**2, (lines, 1)),
                span=5.0,
                transient=transient,
                ends_in=True,
                further_index=(-1,) * count,
                hold=np.zeros((lines, count), dtype=complex),
                staircase_index=(-1,) * count,
                staircase=np.zeros(count),
                step=1e-3,
                columns=np.zeros((lines, count, 0), dtype=complex),
            )
        )
    structure = structure_of(chains)
    names = tuple(f"{a}.time_offset" for a in chains.axes)
    return MissingTorqueProblem(structure, tuple(blocks), delay_names=names)


def cost(problem: MissingTorqueProblem, p: np.ndarray) -> float:
    residual, _ = problem.evaluate(p)
    return float(residual @ residual)


@pytest.mark.parametrize("sizes", [(2,), (3, 1), (3, 2, 3)])
@pytest.mark.parametrize("transient", [False, True])
def test_the_jacobian_gives_the_exact_gradient_of_the_cost(sizes: tuple[int, ...], transient: bool) -> None:
    rng = np.random.default_rng(11)
    chains = random_chains(rng, sizes)
    # Large noise: the part of the gradient that comes from re-evaluating the covariance must count.
    problem = problem_of(chains, rng, noise=0.05, transient=transient)
    p = problem.start(problem.structure.vector(chains)) + 0.0
    p[: sum(sizes)] += 0.02
    residual, jacobian = problem.evaluate(p)
    gradient = 2.0 * jacobian.T @ residual
    for k in range(p.size):
        step = 1e-6 * max(abs(p[k]), 1e-4 if k >= problem.structure.count else 1e-1)
        up, down = p.copy(), p.copy()
        up[k] += step
        down[k] -= step
        numeric = (cost(problem, up) - cost(problem, down)) / (2 * step)
        scale = np.linalg.norm(jacobian[:, k]) * np.linalg.norm(residual)
        assert gradient[k] == pytest.approx(numeric, rel=2e-4, abs=3e-5 * scale), problem.names[k]


def test_condensation_agrees_with_a_full_solve() -> None:
    chains = random_chains(np.random.default_rng(1), (3, 1, 4))
    omega = np.linspace(2, 80, 25)
    structure = structure_of(chains)
    _, stiffness, _ = condense_dense(structure, structure.vector(chains), omega)
    assert np.abs(np.linalg.inv(stiffness) / full_frf(chains, omega) - 1).max() < 1e-9


@pytest.mark.campaign
def test_the_fit_sits_on_its_noise_and_its_errors_are_those_it_states() -> None:
    rng = np.random.default_rng(5)
    chains = random_chains(rng, (2, 2))
    deviations, reduced = [], []
    for _ in range(60):
        problem = problem_of(chains, rng, noise=3e-3, delay=4e-4)
        truth = problem.start(problem.structure.vector(chains))
        truth[problem.slices["delay"]] = 4e-4
        start = truth.copy()
        start[: sum((2, 2)) + 2] += 0.1 * rng.standard_normal(6)
        start[problem.slices["delay"]] = 0.0
        solution = gauss_newton(problem, start)
        assert solution.result == "converged"
        covariance = np.linalg.inv(solution.jacobian.T @ solution.jacobian)
        deviations.append((solution.p - truth) / np.sqrt(np.diag(covariance)))
        reduced.append(solution.reduced)
    z = np.array(deviations)
    # 60 fits of 13 parameters: the mean χ²/ν of 307 degrees of freedom has standard error 0.01.
    assert np.mean(reduced) == pytest.approx(1.0, abs=0.05)
    assert 0.60 < np.mean(np.abs(z) < 1) < 0.76
    assert 0.92 < np.mean(np.abs(z) < 2) < 0.98
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(60)


def test_a_record_from_rest_cut_off_in_motion_is_fitted_without_bias() -> None:
    """Simulated by a matrix exponential; the record starts and ends in full motion."""
    rng = np.random.default_rng(6)
    chains = CoupledChains.build([[1.0, 2.0]], [[4000.0]], [[1.5]])
    n, rate, sub = 4000, 1000.0, 1
    a = np.zeros((4, 4))
    a[:2, 2:] = np.eye(2)
    inverse = np.linalg.inv(chains.mass_matrix)
    a[2:, :2], a[2:, 2:] = -inverse @ chains.stiffness_matrix, -inverse @ chains.damping_matrix
    block = expm(np.block([[a, np.array([[0], [0], [1.0], [0]])], [np.zeros((1, 5))]]) / rate / sub)
    torque = np.convolve(rng.standard_normal(n + 40), np.hanning(40), "valid")[:n]
    x, position = np.array([0.0, 0.0, 0.3, -0.2]), np.empty(n)
    for k in range(n):
        position[k] = x[0]
        x = block[:4, :4] @ x + block[:4, 4] * torque[k]
    experiment = Experiment(
        "000", Kind.OTHER, Role.IDENTIFY, 0, np.zeros(1), 0, np.zeros(0), rate,
        np.arange(n) / rate, position[:, None] + 1e-6 * rng.standard_normal((n, 1)), torque[:, None],
    )  # fmt: skip
    spectra = spectra_of(experiment)
    assert spectra.transient
    problem = problem_from_spectra(ChainStructure((2,), ("A1",)), [spectra])
    start = CoupledChains.build([[1.2, 1.7]], [[3500.0]], [[1.0]])
    solution = gauss_newton(problem, problem.start(problem.structure.vector(start)))
    values = problem.structure.physical(solution.p[: problem.structure.count])
    assert values[:3] == pytest.approx([1.0, 2.0, 4000.0], rel=2e-3)
    assert values[3] == pytest.approx(1.5, rel=0.02)
    assert solution.p[problem.slices["delay"]][0] == pytest.approx(0.0005, rel=0.05)


def test_what_the_band_does_not_reach_is_said_in_words() -> None:
    chains = case_study()
    names, values = parameter_vector(chains)
    covariance = np.diag((1e-4 * np.maximum(np.abs(values), 1.0)) ** 2)
    k2, m3 = names.index("A1.spring.2"), names.index("A1.mass.3")
    for i, j in ((k2, k2), (k2, m3), (m3, k2), (m3, m3)):
        covariance[i, j] = 0.5 * values[i] * values[j]
    covariance[k2, k2] *= 1.001
    blind = blind_directions(chains, names, values, covariance, (0.1, 4.0))
    assert blind.unseen == {"A1.spring.2", "A1.mass.3"}
    assert len(blind.sentences) == 1
    assert "m3 of A1 and K2 of A1: only as a ratio" in blind.sentences[0]
    assert "no excitation above 4 Hz" in blind.sentences[0]


def test_a_known_plant_leaves_nothing_unsaid() -> None:
    chains = case_study()
    names, values = parameter_vector(chains)
    covariance = np.diag((0.01 * np.maximum(np.abs(values), 1e-3)) ** 2)
    blind = blind_directions(chains, names, values, covariance, (0.1, 15.0))
    assert blind.unseen == frozenset()
    assert blind.sentences == ()
