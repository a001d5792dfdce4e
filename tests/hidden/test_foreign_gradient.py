"""The joint fit goes downhill: its gradient is that of the cost, on records that do not close as well."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.discrepancy.linear import layout_of
from invid.discrepancy.plant import Candidate, evaluate
from invid.discrepancy.records import split
from invid.refine.structure import ChainStructure
from invid.spectra import all_spectra

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.foreign import make_foreign


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
