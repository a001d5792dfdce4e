"""Random chains forward, inverse, back; and the lists that must be refused, with the reason."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from invid.errors import InputError, NotIdentifiableError
from invid.inverse import Readings, chain_from_spectrum, paper_inverse
from invid.model.chains import CoupledChains

BOUNDED = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@st.composite
def chains(draw: st.DrawFn, most_branches: int = 8, most_masses: int = 5) -> CoupledChains:
    counts = draw(st.lists(st.integers(1, most_masses), min_size=1, max_size=most_branches))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    masses = [rng.uniform(1.0, 4.0, n) for n in counts]
    springs = [rng.uniform(1000.0, 4000.0, n - 1) for n in counts]
    ends = np.array([m[-1] for m in masses])
    raw = np.triu(rng.uniform(-1, 1, (len(counts), len(counts))), 1)
    couplings = raw * np.sqrt(np.outer(ends, ends)) * 0.8 / max(len(counts) - 1, 1)
    return CoupledChains.build(masses, springs, couplings=couplings + couplings.T)


def exact_eigenvalues(stiffness: np.ndarray, mass: np.ndarray, zeros: int) -> np.ndarray:
    """Rayleigh quotients in extended precision: their error is the square of the vectors'."""
    _, vectors = scipy.linalg.eigh(stiffness, mass)
    wide = vectors.astype(np.longdouble)
    up = np.einsum("ij,ik,kj->j", wide, stiffness.astype(np.longdouble), wide)
    down = np.einsum("ij,ik,kj->j", wide, mass.astype(np.longdouble), wide)
    return np.sort(up / down)[zeros:]


def exact_lists(plant: CoupledChains) -> list[tuple[np.ndarray, np.ndarray]]:
    count = plant.branches
    rigid = np.zeros(1, dtype=np.longdouble)
    poles = np.concatenate(
        (rigid, exact_eigenvalues(plant.stiffness_matrix, plant.mass_matrix, count)), dtype=np.longdouble
    )
    lists = []
    for motor in plant.motor_dofs:
        kept = np.ix_(*[np.delete(np.arange(plant.dofs), motor)] * 2)
        if kept[0].size == 0:
            lists.append((poles, np.zeros(0, dtype=np.longdouble)))
            continue
        zeros = exact_eigenvalues(plant.stiffness_matrix[kept], plant.mass_matrix[kept], count - 1)
        lists.append((poles, zeros))
    return lists


def locked_gains(plant: CoupledChains) -> tuple[np.ndarray, np.ndarray]:
    """A_iL and signed A_C at ω → 0 with the other motors locked, from Newton's law of rigid branches."""
    rigid = plant.rigid_mass_matrix
    cross = np.zeros_like(rigid)
    for i in range(plant.branches):
        for j in range(plant.branches):
            if i != j:
                pair = rigid[np.ix_([i, j], [i, j])]
                cross[i, j] = np.linalg.inv(pair)[0, 1]
    return 1.0 / np.diag(rigid), cross


def assert_same(found: CoupledChains, truth: CoupledChains, tolerance: float) -> None:
    for mine, theirs in zip(found.masses + found.springs, truth.masses + truth.springs, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=tolerance)
    np.testing.assert_allclose(found.couplings, truth.couplings, rtol=tolerance, atol=tolerance * 1e-3)


@BOUNDED
@given(chains())
def test_exact_spectra_give_every_parameter_back_to_1e_6(truth: CoupledChains) -> None:
    low, cross = locked_gains(truth)
    high = [1 / m[0] for m in truth.masses]
    found = paper_inverse(exact_lists(truth), high, low, cross, truth.masses_per_branch)
    assert_same(found, truth, 1e-6)


@BOUNDED
@given(chains(most_branches=4, most_masses=4))
def test_the_readings_of_a_plant_belong_to_it(truth: CoupledChains) -> None:
    assert_same(Readings.of(truth).chains(), truth, 1e-4)


def test_equal_branches_whose_modes_share_their_poles_come_back() -> None:
    truth = CoupledChains.build([[1.0, 2.0, 3.0]] * 2, [[1000.0, 2000.0]] * 2)
    assert_same(Readings.of(truth).chains(), truth, 1e-6)


def two_branches() -> CoupledChains:
    return CoupledChains.build(
        [[1.0, 2.0, 3.0], [2.0, 1.0, 4.0, 2.0]],
        [[1000.0, 1500.0], [800.0, 2000.0, 1200.0]],
        couplings=[[0, 0.9], [0.9, 0]],
    )


def test_the_last_lanczos_step_checks_the_couplings() -> None:
    truth = two_branches()
    inverse = np.linalg.inv(truth.end_mass_matrix)
    for i, (poles, zeros) in enumerate(exact_lists(truth)):
        branch = chain_from_spectrum(
            poles, zeros, truth.masses[i][0], truth.masses[i].sum(), truth.masses[i].size
        )
        assert branch.inverse_end_mass == pytest.approx(inverse[i, i], rel=1e-8)


def test_a_mode_the_motor_cannot_see_is_cancelled_and_said() -> None:
    # two equal uncoupled branches: each sees its own two modes, the list holds both
    single = CoupledChains.build([[1.0, 2.0, 3.0]], [[1000.0, 2000.0]])
    ((poles, zeros),) = exact_lists(single)
    twice_poles = np.sort(np.concatenate((poles, poles[1:])))
    twice_zeros = np.sort(np.concatenate((zeros, poles[1:])))
    branch = chain_from_spectrum(twice_poles, twice_zeros, 1.0, 6.0, 3)
    np.testing.assert_allclose(branch.masses, [1, 2, 3], rtol=1e-9)
    np.testing.assert_allclose(branch.springs, [1000, 2000], rtol=1e-9)
    np.testing.assert_allclose(np.sort(branch.cancelled), poles[1:].astype(float), rtol=1e-12)


def test_too_few_visible_modes_are_refused_with_the_count() -> None:
    with pytest.raises(NotIdentifiableError, match=r"A2: 3 masses need at least 3 resonances.*sees 2"):
        chain_from_spectrum([0.0, 900.0, 2000.0], [500.0, 2000.0], 1.0, 6.0, 3, axis="A2")


def test_an_antiresonance_above_its_resonance_is_refused_with_both_in_hertz() -> None:
    hz = (2 * np.pi) ** 2
    with pytest.raises(
        NotIdentifiableError, match=r"A2: antiresonance 29\.75 Hz lies above resonance 29\.59 Hz.*missed"
    ):
        chain_from_spectrum(
            [0.0, 29.59**2 * hz, 40.0**2 * hz], [29.75**2 * hz, 35.0**2 * hz], 1.0, 6.0, 3, axis="A2"
        )


def test_two_antiresonances_in_a_row_say_that_a_peak_was_missed() -> None:
    with pytest.raises(NotIdentifiableError, match="peak between"):
        chain_from_spectrum([0.0, 900.0, 1600.0], [400.0, 500.0], 1.0, 6.0, 3)


def test_a_branch_sum_below_the_inner_masses_is_refused_with_the_value() -> None:
    truth = CoupledChains.build([[1.0, 2.0, 3.0]], [[1000.0, 2000.0]])
    ((poles, zeros),) = exact_lists(truth)
    with pytest.raises(NotIdentifiableError, match=r"mass 3 came out at -0\.5"):
        chain_from_spectrum(poles, zeros, 1.0, 2.5, 3)


@pytest.mark.parametrize("bad", [np.nan, -1.0, np.inf])
def test_lists_with_values_that_are_no_frequencies_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="finite numbers"):
        chain_from_spectrum([0.0, bad, 1600.0], [400.0, 1000.0], 1.0, 6.0, 3)
