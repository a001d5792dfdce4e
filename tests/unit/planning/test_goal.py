"""Plans for a goal: within the limits, honest about what cannot be reached, and no longer than needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig
from invid.planning.belief import Belief
from invid.planning.forecast import turning_back
from invid.planning.goal import GoalPlan, GoalWish, plan_for_goal
from invid.recording import Recording, read_recording
from invid_drivers.foretelling import sensor_noise
from invid_drivers.measurement import measure_to_file
from invid_drivers.stopping_budgets import Wish


@pytest.fixture(scope="module")
def design(cell: CellConfig, belief: Belief) -> GoalPlan:
    return plan_for_goal(cell, belief, sensor_noise(cell), 0.01)


def with_limits(cell: CellConfig, **limits: float) -> CellConfig:
    document = cell.model_dump(mode="python")
    for axis in document["axes"]:
        axis["limits"] |= limits
    return CellConfig.model_validate(document)


def test_a_goal_of_one_per_cent_is_expected_in_one_block_below_the_largest_amplitude(
    design: GoalPlan,
) -> None:
    assert design.reachable
    assert design.needed == 1
    assert design.expected.worst[1] < 0.01
    climb, *blocks = (np.abs(e.torque).max() for e in design.plan.recorded)
    assert climb < min(blocks)
    assert design.expected_s < 8


def test_no_block_exceeds_torque_travel_or_velocity(cell: CellConfig, belief: Belief) -> None:
    tight = with_limits(cell, position=0.02, velocity=0.3)
    design = plan_for_goal(tight, belief, sensor_noise(tight), 0.01)
    for axis, f in zip(tight.axes, design.plan.forecast, strict=True):
        assert f.peak_torque <= axis.limits.torque
        # with the margin of a model
        assert f.travel <= 0.02
        assert f.velocity <= 0.3
    assert any("velocity of" in w or "travel of" in w for w in design.plan.warnings)


def test_a_goal_beyond_the_limits_is_refused_with_the_figure_that_can_be_reached(
    cell: CellConfig, belief: Belief
) -> None:
    design = plan_for_goal(cell, belief, sensor_noise(cell), 1e-5, GoalWish(max_duration_s=13.0))
    assert not design.reachable
    _, *blocks = design.plan.recorded
    assert sum(e.cycles for e in blocks) * design.plan.cycle_s <= 13.0
    name, worst = design.expected.worst
    assert worst > 1e-5
    assert name in design.sentence
    assert f"{worst:.2g}" in design.sentence
    assert any("duration" in b for b in design.binding)
    assert any("torque of A1 stays within its limit" in b for b in design.binding)


@pytest.mark.campaign
def test_creep_is_planned_where_friction_is_near_the_torque_and_the_config_allows_it(
    cell: CellConfig, belief: Belief
) -> None:
    document = cell.model_dump(mode="python")
    document["experiments"] = [{"kind": "multisine", "creep_velocity": 0.02}]
    allowed = CellConfig.model_validate(document)
    sticky = replace(belief, coulomb=np.array([6.0, 0.2, 0.4]))
    design = plan_for_goal(allowed, sticky, sensor_noise(allowed), 0.01)
    (block, *_) = design.plan.experiments
    assert block.reference is not None
    assert np.abs(block.reference).max(axis=0).all()
    # 0.02 rad/s does not keep a motor going that is shaken faster; what would is said, and does.
    said = [w for w in design.plan.warnings if "turn back" in w]
    assert turning_back(allowed, block, sticky) == said
    assert said[0].startswith("axis A1:")
    enough = max(float(w.split("creep_velocity of ")[1].split()[0]) for w in said)
    path = block.reference * (1.02 * enough / 0.02)
    assert not turning_back(allowed, replace(block, reference=path), sticky)
    plain = plan_for_goal(cell, sticky, sensor_noise(cell), 0.01)
    assert plain.plan.experiments[0].reference is None
    assert any("creep_velocity" in w for w in plain.plan.warnings)


@pytest.mark.campaign
def test_whoever_judges_sees_every_finished_experiment_as_it_stands_in_the_file(
    cell: CellConfig, design: GoalPlan, tmp_path: Path
) -> None:
    path, seen = tmp_path / "r.h5", []

    def go_on(recording: Recording) -> bool:
        seen.append(recording)
        return len(seen) < 2

    blocks = [replace(e, torque=0.5 * e.torque[:1500], record_to=1500) for e in design.plan.experiments]
    plan = replace(design.plan, experiments=tuple(blocks))
    measure_to_file(cell, path, Wish(plan=plan), judge=go_on)
    written = read_recording(path)
    assert [len(r.experiments) for r in seen] == [1, 2]
    assert len(written.experiments) == 3, "the next one went on meanwhile"
    for a, b in zip(seen[-1].experiments, written.experiments, strict=False):
        assert a.key == b.key
        assert np.array_equal(a.position, b.position)
        assert np.array_equal(a.torque, b.torque)
        assert np.array_equal(a.time, b.time)
