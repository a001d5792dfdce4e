"""A spring between two loads that leads the linear fit astray."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from invid.diagnosis.diagnose import diagnose
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make_case


def test_a_spring_that_chains_answered_with_heavy_loads_is_found_where_the_lowest_lines_put_it() -> None:
    """33 dB: the identification ends at loads of a thousand times their mass that move together only."""
    recording, truth = make_case(970048)
    # What it comes out with, in 28 s.
    lost = CoupledChains.build(
        [[24.24, 93.87, 3.263e4], [32.19, 62.54, 3.915e4]],
        [[8168.0, 82.12], [31423.0, 23404.0]],
        [[0.0, 0.0], [0.0, 0.0]],
        np.array([[0.0, -3.572e4], [-3.572e4, 0.0]]),
        axes=truth.chains.axes,
    )
    found = diagnose(recording, model=_model(recording.robot, lost))
    (finding,) = found.findings
    assert finding.effect.cause == "coupling_stiffness"
    true = truth.effects[0].parameters["stiffness"]
    assert abs(finding.effect.value("stiffness") / true - 1.0) < 0.01
    for axis in (0, 1):
        np.testing.assert_allclose(found.model.chains.masses[axis], truth.chains.masses[axis], rtol=0.01)


def _model(robot: str, chains: CoupledChains) -> Model:
    return Model(robot=robot, method="by hand", chains=chains, std=ChainStd.unknown(chains))
