"""The force of a spring with free play, read from the torque: derivatives, and what is read at the truth."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.rules.wide_gap_fit import FreePlay
from invid.diagnosis.search_pass import _begun
from invid.diagnosis.validation import PLAIN
from invid.effects.catalogue.backlash import RattlingBacklash
from invid.likelihood.joint_fit import limits_of
from invid.likelihood.placed_effect import Term
from invid.model.document import ChainStd, Model
from invid.model.place import spring_places
from invid.numerics.arrays import Float64

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

GAP = 0.0049


@pytest.fixture(scope="module", params=[False, True], ids=["closed", "from rest"])
def play(request: pytest.FixtureRequest) -> tuple[FreePlay, Float64, tuple[Float64, Float64]]:
    """The spring with its gap in records, the true parameters (n,) but for times, and their limits."""
    recording, truth = make(
        "backlash", (0, 1), {"gap": GAP}, seed=4711, masses=(2,), noise=1e-3, bits=20, periods=1,
        drive="smooth", from_rest=request.param,
    )  # fmt: skip
    chains = truth.chains
    model = Model(robot=recording.robot, method="by hand", chains=chains, std=ChainStd.unknown(chains))
    _, _, (base, _, train, _) = _begun(recording, model, PLAIN)
    structure = base.layout.structure
    p = base.p.copy()
    p[: structure.count] = structure.vector(chains)
    limits = limits_of(base.layout, base.candidate, base.evaluation, True)
    return FreePlay(base.layout, train, Term(RattlingBacklash(), spring_places(structure)[0])), p, limits


def test_the_jacobian_of_what_is_asked_of_the_unknowns_is_that_of_differences(
    play: tuple[FreePlay, Float64, tuple[Float64, Float64]],
) -> None:
    free, p, _ = play
    gap = free.gap(p, float(np.log(GAP)))
    reading = free.readings(p, 0.1)[0]
    u = reading.solved(np.zeros(reading.count), gap, 3)
    residual, wave = reading.residual(u, gap)
    rows, _ = reading.linearised(wave, gap)
    direction = np.random.default_rng(0).normal(size=u.size) * np.abs(u).max()
    h = 1e-6  # few samples cross the gap's edge
    change = (reading.residual(u + h * direction, gap)[0] - residual) / h
    law = slice(2 * reading.felt.size, 2 * reading.felt.size + rows.shape[0])
    np.testing.assert_allclose(change[law], rows @ direction, atol=2e-2 * np.abs(change[law]).max())
    gathered = reading.gathered(change[:, None], rows)[:, 0]
    normal = reading._normal + rows.T @ rows
    np.testing.assert_allclose(gathered, normal @ direction, atol=2e-2 * np.abs(gathered).max())


def test_from_the_truth_the_law_comes_to_hold_to_a_hundredth_of_the_torque(
    play: tuple[FreePlay, Float64, tuple[Float64, Float64]],
) -> None:
    free, p, limits = play
    right = free.fitted(free.solved(p, float(np.log(GAP)), None, 0.1), 0.1, limits)
    right = free.fitted(right, 0.01, limits)
    rows = sum(2 * r.torque.size for r in free.records)
    assert right.cost < rows
    assert abs(right.width - np.log(GAP)) < 0.02
    std = np.sqrt(free.covariance(right)[-1, -1])
    assert 0.01 <= std < 0.03
    wider = free.solved(right.p, right.width + 0.3, right.unknown, 0.01)
    assert wider.cost > 5.0 * right.cost
