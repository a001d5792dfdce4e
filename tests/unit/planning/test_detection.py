"""What a plan says that it would show, and runs that are no longer than that asks for."""

import pytest

from invid.config import CellConfig
from invid.planning import make_plan
from invid.planning.belief import Belief
from invid.planning.detection import DetectionLimit, detection_limits
from invid.planning.expected_covariance import fit_about
from invid.planning.goal import shortest_runs
from invid_drivers.foretelling import sensor_noise
from invid_drivers.goal import reached


@pytest.fixture(scope="module")
def limits(cell: CellConfig, belief: Belief) -> dict[tuple[str, str], DetectionLimit]:
    plan = make_plan(cell, model=belief)
    found = detection_limits(cell, plan.recorded, belief, sensor_noise(cell))
    return {(limit.cause, limit.axis): limit for limit in found}


def test_the_default_plan_shows_the_frictions_of_the_case_study_and_free_play_below_what_is_sold_as_low(
    limits: dict[tuple[str, str], DetectionLimit], cell: CellConfig
) -> None:
    # what `bench_plan.py` then finds in twenty of twenty recordings
    for axis, dry, viscous in (("A1", 0.1, 0.1), ("A2", 0.2, 0.2), ("A3", 0.4, 0.4)):
        assert limits["coulomb_friction", axis].size < 0.6 * dry
        assert limits["viscous_friction", axis].size < viscous
        assert limits["backlash", axis].size < cell.sizes_of_interest.free_play
    assert {limit.unit for limit in limits.values()} == {"N·m", "N·m·s/rad", "rad", "kg·m²"}


@pytest.mark.campaign
def test_runs_are_no_longer_than_what_is_of_interest_asks_for(cell: CellConfig, belief: Belief) -> None:
    def seconds(**sizes: float) -> float:
        interest = cell.sizes_of_interest.model_copy(update=sizes)
        wanted = cell.model_copy(update={"sizes_of_interest": interest})
        return shortest_runs(wanted, belief, sensor_noise(cell)).period_s

    coarse = dict.fromkeys(("dry_friction", "viscous_friction", "mode", "free_play"), 1.0)
    assert seconds(**coarse) == 5.0
    assert 5.0 < seconds(**(coarse | {"viscous_friction": 0.005})) < 10.5
    assert seconds(**(coarse | {"viscous_friction": 0.001})) == 10.5


@pytest.mark.campaign
def test_records_show_about_what_was_foretold_of_them(
    limits: dict[tuple[str, str], DetectionLimit], cell: CellConfig, belief: Belief
) -> None:
    plan = make_plan(cell, model=belief)
    _, recording = fit_about(cell, plan.recorded, belief, sensor_noise(cell))
    found = reached(recording, (3, 3, 3), interests=cell)
    assert found.trustworthy
    for limit in found.limits:
        assert 0.5 < limit.size / limits[limit.cause, limit.axis].size < 2.0
    assert found.shown == sum(limit.is_met for limit in found.limits)
    assert found.meets(0.01) == (found.shown == len(found.limits))
    assert not found.meets(1e-6)
