"""Plans: limits kept, budget as in the notes, forecasts against physics done by hand."""

import numpy as np
import pytest

from invid.config import CellConfig, parse_config
from invid.errors import ConfigError
from invid.model.chains import case_study
from invid.planning import make_plan
from invid.planning.belief import Belief
from invid.planning.build import axes_left_out, require_all_axes
from invid.planning.response import foretold_motion


def cell(experiments: str = "", *, axes: int = 3, bus: str = "", extra: str = "") -> CellConfig:
    rows = "\n".join(
        f"  - {{name: A{i + 1}, node_id: {i + 1}, inertia: {5.0 * (i + 1)}, "
        f"limits: {{torque: {10 * (i + 1)}, position: 0.5, velocity: 3}}{extra}}}"
        for i in range(axes)
    )
    return parse_config(
        f"format: invid-config\nrobot: r\nbus: {{interface: invid-virtual, channel: x{bus}}}\naxes:\n{rows}\n"
        + (f"experiments: {experiments}\n" if experiments else "")
    )


def test_a_bus_over_its_budget_is_refused_with_a_cycle_that_would_do() -> None:
    with pytest.raises(ConfigError, match=r"cycle_s to 0\.002"):
        make_plan(cell(axes=4))
    make_plan(cell(axes=4, bus=", cycle_s: 0.002"))


def test_a_subset_of_the_axes_is_refused_with_the_way_out() -> None:
    with pytest.raises(ConfigError, match=r"axis A2, A3 would be held.*--screen"):
        require_all_axes(cell(), ["A1"])
    require_all_axes(cell(), ["A3", "A1", "A2"])
    require_all_axes(cell(), None)
    assert axes_left_out(cell(), ["A1", "A3"]) == ("A2",)


def test_a_run_from_rest_leaves_a_free_axis_where_it_was() -> None:
    for e in make_plan(cell()).experiments:
        for i, axis in enumerate(cell().axes):
            velocity = np.cumsum(e.torque[:, i]) * 0.001 / axis.inertia
            # without a hold, in a window of ±0.5
            assert np.abs(np.cumsum(velocity) * 0.001).max() < 0.25
            assert abs(velocity.mean()) * e.cycles * 0.001 < 0.1


def test_no_plan_asks_for_more_torque_than_the_limit() -> None:
    plan = make_plan(cell("[{kind: multisine, amplitude: 1.0}, {kind: chirp, amplitude: 1.0}]"))
    for e in plan.experiments:
        assert np.all(np.abs(e.torque).max(axis=0) <= np.array([10, 20, 30]) * (1 + 1e-9))


def test_without_a_model_the_limits_are_announced_and_it_is_said_why() -> None:
    config = cell()
    for share in (1.0, 0.1):
        plan = make_plan(config, amplitude_scale=share)
        for f, axis in zip(plan.forecast, config.axes, strict=True):
            assert f.basis == "limits"
            assert f.peak_torque == axis.limits.torque
            assert 0.1 * axis.limits.position <= f.travel <= axis.limits.position
        assert any("no model of this cell" in w for w in plan.warnings)
    assert plan.forecast[0].travel < config.axes[0].limits.position / 2
    known = make_plan(config, model=case_study(damping_ratio=0.01))
    assert all(f.basis == "model" for f in known.forecast)
    assert not any("no model" in w for w in known.warnings)


def test_a_move_that_leaves_the_window_is_refused() -> None:
    with pytest.raises(ConfigError, match="position window"):
        make_plan(cell("[{kind: constant_velocity, velocities: [0.1], travel: 1.5}]"))


def test_a_band_beyond_what_the_cycle_can_carry_is_refused() -> None:
    with pytest.raises(ConfigError, match="tenth of the cycle rate"):
        make_plan(cell("[{kind: multisine, band_Hz: [1, 150]}]"))


def test_where_the_inertia_says_that_an_axis_leaves_its_window_its_torque_is_lowered_and_it_is_said() -> None:
    usual, light = cell(), cell()
    axes = [light.axes[0].model_copy(update={"inertia": 0.05}), *light.axes[1:]]
    plan = make_plan(light.model_copy(update={"axes": axes}))
    (said,) = [w for w in plan.warnings if "planned at" in w and w.startswith("axis A1")]
    assert "travel of A1" in said
    first, other = (np.abs(p.experiments[0].torque).max(axis=0) for p in (plan, make_plan(usual)))
    assert first[0] < 0.5 * other[0]
    assert first[1] == pytest.approx(other[1])


def test_a_slow_move_at_a_tenth_of_the_amplitude_is_announced_as_far_as_it_goes() -> None:
    moves = "[{kind: multisine}, {kind: constant_velocity, velocities: [0.2], travel: 0.7, axes: [A1]}]"
    plan = make_plan(cell(moves), amplitude_scale=0.1)
    first, other = plan.forecast[:2]
    assert first.travel >= 0.35 + 0.1 * first.travel_limit
    assert other.travel < 0.5 * other.travel_limit
    assert first.velocity >= 0.2


def test_no_limit_is_left_by_what_is_announced_from_a_model() -> None:
    config = cell()
    axes = [
        a.model_copy(update={"limits": a.limits.model_copy(update={"position": 0.02})}) for a in config.axes
    ]
    tight = config.model_copy(update={"axes": axes})
    plant = Belief(case_study(damping_ratio=0.01), np.zeros(3), np.zeros(3), "case study", False)
    plan = make_plan(tight, model=plant)
    for e in plan.experiments:
        motion = foretold_motion(tight, e, plant)
        assert np.abs(motion.position).max() < 0.02
        told = np.array([[f.travel, f.velocity, f.peak_torque] for f in plan.forecast]).T
        seen = np.abs([motion.position, motion.velocity, motion.torque]).max(axis=1)
        assert np.all(seen <= told)
