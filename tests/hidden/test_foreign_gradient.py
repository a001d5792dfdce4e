"""The joint fit goes downhill: its gradient is that of its cost, on open records and beside a gap."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.linear_fit import layout_of
from invid.diagnosis.score_test import Screen
from invid.diagnosis.validation import split_records
from invid.effects.catalogue.backlash import Backlash
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.likelihood.evaluation import evaluate
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import fit
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.likelihood.prepare_records import spectral_record, split_into_periods
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.recording import Role
from invid.signals.spectra import all_spectra, spectra_of
from invid.signals.spectral_record import SpectralRecord

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.foreign import make_foreign
from hidden.generator import make


def near_the_truth(
    train: Sequence[SpectralRecord], chains: CoupledChains, spread: float
) -> tuple[Layout, Float64]:
    """Layout, and its parameters off the true ones by a random share: at the minimum no gradient tells."""
    structure = ChainStructure(chains.masses_per_branch, chains.axes, viscous=False)
    layout = layout_of(structure, train, 0.0)
    p = np.full(layout.count, 0.5)
    p[: structure.count] = structure.vector(chains)
    p[: structure.count] *= 1.0 + spread * np.random.default_rng(0).normal(size=structure.count)
    p[structure.count : structure.count + structure.motors] = 0.5 * layout.step
    return layout, p


def central(cost: Callable[[Float64], float], at: Float64, k: int, h: float) -> float:
    """Derivative of ``cost`` by the k-th of ``at``, by differences to both sides."""
    up, down = at.copy(), at.copy()
    up[k] += h
    down[k] -= h
    return (cost(up) - cost(down)) / (2.0 * h)


@pytest.mark.parametrize(("seed", "motors"), [(540031, 1), (540044, 2)])
def test_the_gradient_of_an_aperiodic_record_is_that_of_its_cost(seed: int, motors: int) -> None:
    recording, truth = make_foreign(seed, cause="null", excitation="noise", motors=motors)
    train, _, _ = split_records(recording, all_spectra(recording))
    layout, p = near_the_truth(train, truth.chains, 1e-3)
    here = evaluate(layout, train, p, Candidate())
    gradient = 2.0 * here.jacobian.T @ here.residual

    def cost(at: Float64) -> float:
        return evaluate(layout, train, at, Candidate(), jacobian=False).cost

    for k in range(layout.structure.count):
        assert gradient[k] == pytest.approx(central(cost, p, k, 1e-6), rel=0.02, abs=2.0), layout.names[k]


@pytest.mark.parametrize(("seed", "masses"), [(11, 2), (12, 3)])
def test_the_gradient_knows_what_masses_and_springs_do_to_a_gap_of_the_last_spring(
    seed: int, masses: int
) -> None:
    """It moves the spring's ends by a third of what they move, and by a hundredth of the axis' motion."""
    recording, truth = make(
        "backlash",
        (0, masses - 1),
        seed=seed,
        masses=(masses,),
        target_db=35.0,
        noise=0.003,
        drive="smooth",
        from_rest=False,
        moves=False,
        periods=2,
    )
    train, _, _ = split_records(recording, all_spectra(recording))
    layout, p = near_the_truth(train, truth.chains, 2e-3)
    structure = layout.structure
    gap = np.array([np.log(truth.effects[0].parameters["gap"])])
    candidate = Candidate((PlacedEffect(Backlash(), Place("spring", 0, masses - 1)),), (gap,))
    here = evaluate(layout, train, p, candidate, thorough=True)
    gradient = 2.0 * here.jacobian.T @ here.residual
    largest = np.abs(gradient[: structure.count]).max()

    def cost(at: Float64) -> float:
        return evaluate(layout, train, at, candidate, jacobian=False, near=here.views).cost

    for k in range(structure.count):
        expected = central(cost, p, k, 1e-4 * max(abs(float(p[k])), 1e-2))
        # Inner motion and forces agree to a few per cent only after the fixed number of steps.
        assert gradient[k] == pytest.approx(expected, rel=0.1, abs=0.01 * largest), layout.names[k]


def test_a_gap_is_seen_in_a_chirp_from_rest_whose_ends_move_the_load_within_it() -> None:
    """Seed 670007: a mode, a gear error and eccentricity were screened before the gap, which took a tenth."""
    recording, truth = make_foreign(670007)
    train, _, _ = split_records(recording, all_spectra(recording))
    layout, p = near_the_truth(train, truth.chains, 1e-3)
    linear = fit(layout, train, p, Candidate(), iterations=25)
    seen = Screen(linear).best(PlacedEffect(Backlash(), Place("spring", 0, 1)), polish=True)
    assert seen.gain > 0.8 * linear.cost
    assert np.exp(seen.x[0]) == pytest.approx(truth.effects[0].parameters["gap"], rel=0.1)


@pytest.mark.parametrize("from_rest", [False, True])
@pytest.mark.parametrize("cause", ["extra_mode", "viscous_friction"])
def test_the_gradient_knows_what_masses_and_springs_do_to_an_effect_linear_in_inner_motion(
    cause: str, from_rest: bool
) -> None:
    recording, truth = make(
        cause,
        (0, 2),
        seed=21,
        masses=(3,),
        target_db=25.0,
        noise=0.003,
        drive="smooth",
        from_rest=from_rest,
        moves=False,
        periods=2,
    )
    spectra = [spectra_of(e, drop_transient=False) for e in recording.experiments if e.role is Role.IDENTIFY]
    experiments = {e.key: e for e in recording.experiments}
    whole = [spectral_record(s, experiments[s.key]) for s in spectra]
    train = split_into_periods(recording, whole, [s.key for s in spectra]) if from_rest else whole
    layout, p = near_the_truth(train, truth.chains, 2e-3)
    size = truth.effects[0].parameters
    effect, x = {
        "extra_mode": lambda: (
            ExtraMode(),
            [size["mass"], 0.5 * np.log(size["stiffness"] / size["mass"]), np.log(0.01)],
        ),
        "viscous_friction": lambda: (ViscousFriction(), [size["coefficient"]]),
    }[cause]()
    candidate = Candidate((PlacedEffect(effect, Place("mass", 0, 2)),), (np.array(x),))
    here = evaluate(layout, train, p, candidate)
    gradient = 2.0 * here.jacobian.T @ here.residual
    chosen = [*range(layout.structure.count), *range(layout.count, gradient.size)]
    largest = np.abs(gradient[chosen]).max()
    both = np.append(p, x)

    def cost(at: Float64) -> float:
        changed = Candidate(candidate.terms, (at[p.size :],))
        return evaluate(layout, train, at[: p.size], changed, jacobian=False).cost

    for k in chosen:
        expected = central(cost, both, k, 1e-5 * max(abs(float(both[k])), 1e-2))
        assert gradient[k] == pytest.approx(expected, rel=0.1, abs=0.01 * largest), k
