"""Plans of a screening: within the limits, and no longer than needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig
from invid.planning import make_plan
from invid.planning.belief import Belief
from invid.planning.expected_covariance import expected
from invid.planning.forecast import turning_back
from invid.planning.model import Plan
from invid.planning.screening import BLOCKS_S, GOAL, LONGEST_S, screening_plan
from invid.recording import Recording, read_recording
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated.config import sensor_noise
from invid_drivers.stopping_budgets import Wish


@pytest.fixture(scope="module")
def design(cell: CellConfig, belief: Belief) -> Plan:
    return screening_plan(cell, belief, sensor_noise(cell))


def with_limits(cell: CellConfig, **limits: float) -> CellConfig:
    document = cell.model_dump(mode="python")
    for axis in document["axes"]:
        axis["limits"] |= limits
    return CellConfig.model_validate(document)


def test_the_goal_is_expected_after_the_climb_and_one_block_below_the_largest_amplitude(
    cell: CellConfig, belief: Belief, design: Plan
) -> None:
    assert expected(cell, design.recorded, belief, sensor_noise(cell)).worst[1] < GOAL
    climb, block = (np.abs(e.torque).max() for e in design.recorded)
    assert climb < block
    assert design.shaking_s < 8


def test_no_block_exceeds_torque_travel_or_velocity(cell: CellConfig, belief: Belief) -> None:
    tight = with_limits(cell, position=0.02, velocity=0.3)
    design = screening_plan(tight, belief, sensor_noise(tight))
    for axis, f in zip(tight.axes, design.forecast, strict=True):
        assert f.peak_torque <= axis.limits.torque
        # with the margin of a model
        assert f.travel <= 0.02
        assert f.velocity <= 0.3
    assert any("velocity of" in w or "travel of" in w for w in design.warnings)


def test_a_plan_that_cannot_reach_the_goal_is_as_long_as_a_screening_may_be(
    cell: CellConfig, belief: Belief
) -> None:
    faint = screening_plan(cell, belief, sensor_noise(cell), amplitude_scale=0.02)
    _, *blocks = faint.recorded
    assert LONGEST_S - max(BLOCKS_S) < sum(e.cycles for e in blocks) * faint.cycle_s <= LONGEST_S


@pytest.mark.campaign
def test_creep_is_planned_where_friction_is_near_the_torque_and_the_config_allows_it(
    cell: CellConfig, belief: Belief
) -> None:
    document = cell.model_dump(mode="python")
    document["experiments"] = [{"kind": "multisine", "creep_velocity": 0.02}]
    allowed = CellConfig.model_validate(document)
    sticky = replace(belief, coulomb=np.array([6.0, 0.2, 0.4]))
    design = screening_plan(allowed, sticky, sensor_noise(allowed))
    (block, *_) = design.experiments
    assert block.reference is not None
    assert np.abs(block.reference).max(axis=0).all()
    # 0.02 rad/s does not keep a motor going that is shaken faster; what would is said, and does.
    said = [w for w in design.warnings if "turn back" in w]
    assert turning_back(allowed, block, sticky) == said
    assert said[0].startswith("axis A1:")
    enough = max(float(w.split("creep_velocity of ")[1].split()[0]) for w in said)
    path = block.reference * (1.02 * enough / 0.02)
    assert not turning_back(allowed, replace(block, reference=path), sticky)
    plain = screening_plan(cell, sticky, sensor_noise(cell))
    assert plain.experiments[0].reference is None
    assert any("creep_velocity" in w for w in plain.warnings)


@pytest.mark.campaign
def test_whoever_judges_sees_every_finished_experiment_as_it_stands_in_the_file(
    cell: CellConfig, belief: Belief, tmp_path: Path
) -> None:
    path, seen = tmp_path / "r.h5", []

    def go_on(recording: Recording) -> bool:
        seen.append(recording)
        return len(seen) < 2

    plan = make_plan(cell, amplitude_scale=0.5, model=belief)
    blocks = [replace(e, torque=e.torque[:1500], record_to=1500) for e in plan.experiments]
    plan = replace(plan, experiments=tuple(blocks))
    measure_to_file(cell, path, Wish(plan=plan), judge=go_on)
    written = read_recording(path)
    assert [len(r.experiments) for r in seen] == [1, 2]
    assert len(written.experiments) == 3, "the next one went on meanwhile"
    for a, b in zip(seen[-1].experiments, written.experiments, strict=False):
        assert a.key == b.key
        assert np.array_equal(a.position, b.position)
        assert np.array_equal(a.torque, b.torque)
        assert np.array_equal(a.time, b.time)
