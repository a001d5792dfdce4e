"""Chains recorded without a period are taken for chains, and identified as from periods."""

import numpy as np
import pytest

from hidden.aperiodic import draw
from invid.identification.identify import identify


@pytest.mark.parametrize(("seed", "motion"), [(1, "noise"), (3, "moves"), (15, "moves"), (11, "chirp")])
def test_an_elastic_axis_is_told_from_a_rigid_one_by_what_each_misses(seed: int, motion: str) -> None:
    recording, truth = draw(seed, motion)
    model = identify(recording)
    assert model.fit["trustworthy"]
    assert model.chains.masses[0].size == truth.masses.size
    springs, std = model.chains.springs[0], model.std.springs[0]
    assert np.abs((springs - truth.springs) / std).max() < 4.0
    assert np.abs(springs / truth.springs - 1.0).max() < 2e-3
    # The motor's own mass hangs on when its friction turns round, which no such record tells well.
    assert np.abs(model.chains.masses[0][1:] / truth.masses[1:] - 1.0).max() < 5e-3
    assert any("rigid axes miss" in w for w in model.warnings) or motion == "chirp"
