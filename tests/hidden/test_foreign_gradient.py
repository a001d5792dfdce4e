"""The joint fit goes downhill: its gradient is that of its cost, on open records and beside a gap."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.discrepancy.linear import layout_of
from invid.discrepancy.plant import evaluate
from invid.discrepancy.records import by_period, record_of, split
from invid.discrepancy.terms import Candidate, Term
from invid.effects.backlash import Backlash
from invid.effects.extra_mode import ExtraMode
from invid.effects.place import Place
from invid.effects.viscous_friction import ViscousFriction
from invid.recording import Role
from invid.refine.structure import ChainStructure
from invid.spectra import all_spectra, spectra_of

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.foreign import make_foreign
from hidden.generator import make


@pytest.mark.parametrize(("seed", "motors"), [(540031, 1), (540044, 2)])
def test_the_gradient_of_an_aperiodic_record_is_that_of_its_cost(seed: int, motors: int) -> None:
    recording, truth = make_foreign(seed, cause="null", excitation="noise", motors=motors)
    train, _, _ = split(recording, all_spectra(recording))
    structure = ChainStructure(truth.chains.masses_per_branch, truth.chains.axes, viscous=False)
    layout = layout_of(structure, train, 0.0)
    p = np.full(layout.count, 0.5)
    p[: structure.count] = structure.vector(truth.chains)
    p[structure.count : structure.count + motors] = 0.5 * layout.step
    p *= 1.0 + 1e-3 * np.random.default_rng(0).normal(size=p.size)  # away from the minimum
    here = evaluate(layout, train, p, Candidate())
    gradient = 2.0 * here.jacobian.T @ here.residual
    for k in range(structure.count):
        costs = []
        for sign in (1.0, -1.0):
            moved = p.copy()
            moved[k] += sign * 1e-6
            costs.append(evaluate(layout, train, moved, Candidate(), jacobian=False).cost)
        assert gradient[k] == pytest.approx((costs[0] - costs[1]) / 2e-6, rel=0.02, abs=2.0), layout.names[k]


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
    train, _, _ = split(recording, all_spectra(recording))
    structure = ChainStructure(truth.chains.masses_per_branch, truth.chains.axes, viscous=False)
    layout = layout_of(structure, train, 0.0)
    p = np.full(layout.count, 0.5)
    p[: structure.count] = structure.vector(truth.chains)
    p[: structure.count] *= 1.0 + 2e-3 * np.random.default_rng(0).normal(size=structure.count)
    p[structure.count : structure.count + 1] = 0.5 * layout.step
    gap = np.array([np.log(truth.effects[0].parameters["gap"])])
    candidate = Candidate((Term(Backlash(), Place("spring", 0, masses - 1)),), (gap,))
    here = evaluate(layout, train, p, candidate, thorough=True)
    gradient = 2.0 * here.jacobian.T @ here.residual
    largest = np.abs(gradient[: structure.count]).max()
    for k in range(structure.count):
        h, costs = 1e-4 * max(abs(float(p[k])), 1e-2), []
        for sign in (1.0, -1.0):
            moved = p.copy()
            moved[k] += sign * h
            costs.append(evaluate(layout, train, moved, candidate, jacobian=False, near=here.views).cost)
        # Inner motion and forces agree to a few per cent only after the fixed number of steps.
        expected = (costs[0] - costs[1]) / (2.0 * h)
        assert gradient[k] == pytest.approx(expected, rel=0.1, abs=0.01 * largest), layout.names[k]


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
    whole = [record_of(s, experiments[s.key]) for s in spectra]
    train = by_period(recording, whole, [s.key for s in spectra]) if from_rest else whole
    structure = ChainStructure(truth.chains.masses_per_branch, truth.chains.axes, viscous=False)
    layout = layout_of(structure, train, 0.0)
    p = np.full(layout.count, 0.5)
    p[: structure.count] = structure.vector(truth.chains)
    p[structure.count : structure.count + 1] = 0.5 * layout.step
    p[: structure.count] *= 1.0 + 2e-3 * np.random.default_rng(0).normal(size=structure.count)
    size = truth.effects[0].parameters
    effect, x = {
        "extra_mode": lambda: (
            ExtraMode(),
            [size["mass"], 0.5 * np.log(size["stiffness"] / size["mass"]), np.log(0.01)],
        ),
        "viscous_friction": lambda: (ViscousFriction(), [size["coefficient"]]),
    }[cause]()
    candidate = Candidate((Term(effect, Place("mass", 0, 2)),), (np.array(x),))
    here = evaluate(layout, train, p, candidate)
    gradient = 2.0 * here.jacobian.T @ here.residual
    chosen = [*range(structure.count), *range(layout.count, gradient.size)]
    largest = np.abs(gradient[chosen]).max()
    for k in chosen:
        h, costs = 1e-5 * max(abs(float(np.append(p, x)[k])), 1e-2), []
        for sign in (1.0, -1.0):
            moved = np.append(p, x)
            moved[k] += sign * h
            changed = Candidate(candidate.terms, (moved[p.size :],))
            costs.append(evaluate(layout, train, moved[: p.size], changed, jacobian=False).cost)
        assert gradient[k] == pytest.approx((costs[0] - costs[1]) / (2 * h), rel=0.1, abs=0.01 * largest), k
