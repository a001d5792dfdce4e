"""A spring between two loads that leads the linear fit astray."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from invid.chains import CoupledChains
from invid.discrepancy import diagnose
from invid.model import ChainStd, Model

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make_case


def test_a_spring_that_chains_answered_with_heavy_loads_is_found_where_the_lowest_lines_put_it() -> None:
    """33 dB: the identification ends at loads of a thousand times their mass that move together only."""
    recording, truth = make_case(970048)
    first, second = (m.copy() for m in truth.chains.masses)
    between = np.array([[0.0, -3.57e4], [-3.57e4, 0.0]])
    first[1], first[2], second[2] = 93.9, 3.26e4, 3.91e4  # what it comes out with
    springs = (np.array([truth.chains.springs[0][0], 82.0]), truth.chains.springs[1])
    lost = replace(truth.chains, masses=(first, second), springs=springs, couplings=between)
    found = diagnose(recording, model=_model(recording.robot, lost))
    (finding,) = found.findings
    assert finding.effect.cause == "coupling_stiffness"
    true = truth.effects[0].parameters["stiffness"]
    assert abs(finding.effect.value("stiffness") / true - 1.0) < 0.01
    for axis in (0, 1):
        np.testing.assert_allclose(found.model.chains.masses[axis], truth.chains.masses[axis], rtol=0.01)


def _model(robot: str, chains: CoupledChains) -> Model:
    return Model(robot=robot, method="by hand", chains=chains, std=ChainStd.unknown(chains))
