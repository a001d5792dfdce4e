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


def test_a_hold_that_nothing_shows_does_not_bend_the_motor_s_mass() -> None:
    recording, truth = draw(102)
    model = identify(recording)
    mass, std = model.chains.masses[0][0], model.std.masses[0][0]
    assert abs(mass / truth.masses[0] - 1.0) < 5e-3  # was 3.6 %, seven standard deviations
    assert abs(mass - truth.masses[0]) < 3.0 * std


@pytest.mark.parametrize("seed", [2600000, 880005])
def test_a_mode_behind_friction_or_below_the_floor_is_found_in_a_record_that_does_not_close(
    seed: int,
) -> None:
    recording, truth = draw(seed)
    model = identify(recording)
    assert model.chains.masses[0].size == truth.masses.size == 4
    assert np.abs((model.chains.masses[0] - truth.masses) / model.std.masses[0]).max() < 3.0
    assert np.abs((model.chains.springs[0] - truth.springs) / model.std.springs[0]).max() < 3.0
