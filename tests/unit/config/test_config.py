"""Configs: what is taken, and what is refused with file, line, field, value and the way out."""

from pathlib import Path

import pytest

from invid.config import CellConfig, load_config, parse_config
from invid.errors import ConfigError
from invid.planning import bus_budget

GOOD = """format: invid-config
robot: two axes
bus: {interface: invid-virtual, channel: x}
axes:
  - name: A1
    node_id: 1
    limits: {torque_Nm: 10, position_window_rad: 0.1, velocity_rad_per_s: 1e-1}
  - name: A2
    node_id: 2
    limits: {torque_Nm: 20, position_window_rad: 0.1, velocity_rad_per_s: 1}
"""
CONFIGS = sorted((Path(__file__).parents[3] / "configs").glob("*.yaml"))


def message(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, source="cell.yaml")
    return str(caught.value)


def test_units_in_keys_fill_the_same_fields_for_rotary_and_linear_axes() -> None:
    rotary = parse_config(GOOD)
    linear = parse_config(
        GOOD.replace("robot:", "motion: linear\nrobot:")
        .replace("torque_Nm", "force_N")
        .replace("window_rad", "window_m")
        .replace("velocity_rad_per_s", "velocity_m_per_s")
    )
    assert rotary.axes[0].limits == linear.axes[0].limits
    assert rotary.axes[0].limits.torque == 10
    assert rotary.axes[0].limits.velocity == pytest.approx(0.1)


def test_a_negative_limit_is_refused_with_its_line_field_and_value() -> None:
    said = message(GOOD.replace("torque_Nm: 20", "torque_Nm: -20"))
    assert said.startswith("cell.yaml:10:")
    assert "axes[1].limits.torque_Nm is -20" in said


def test_a_key_in_the_units_of_the_other_motion_is_refused() -> None:
    said = message(
        GOOD.replace("position_window_rad: 0.1, velocity_rad_per_s: 1}", "position_window_m: 0.1}")
    )
    assert "cell.yaml:10" in said
    assert "linear" in said


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [("name: A2", "name: A1", "A1"), ("node_id: 2", "node_id: 1", "node_id 1")],
)
def test_axis_names_and_node_ids_may_not_repeat(old: str, new: str, word: str) -> None:
    said = message(GOOD.replace(old, new))
    assert word in said
    assert "more than one axis" in said


def test_a_key_that_stands_twice_is_refused() -> None:
    assert "stands twice" in message(GOOD + "robot: again\n")


def test_a_missing_limit_is_named() -> None:
    said = message(GOOD.replace("torque_Nm: 20, ", ""))
    assert "axes[1].limits" in said
    assert "missing" in said


@pytest.mark.parametrize("value", [".inf", ".nan", "ten", "[1]", "null"])
def test_a_limit_that_is_no_finite_number_is_refused(value: str) -> None:
    assert "torque_Nm" in message(GOOD.replace("torque_Nm: 20", f"torque_Nm: {value}"))


def test_a_yaml_bomb_ends_before_it_fills_the_memory() -> None:
    bomb = "a: &a [1,1,1,1,1,1,1,1,1]\n"
    for n, (new, old) in enumerate(zip("bcdefghij", "abcdefghi", strict=True)):
        bomb += f"{new}: &{new} [" + ",".join([f"*{old}"] * 9) + f"]  # {n}\n"
    assert "aliases" in message(GOOD + bomb)


@pytest.mark.parametrize(
    "text", ["", "just a word", "[1, 2]", "format: [unclosed", "format: other\n", "\x00"]
)
def test_a_text_that_is_no_config_is_one_message(text: str) -> None:
    assert message(text).startswith("cell.yaml")


def test_a_missing_file_and_a_folder_are_one_message(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(ConfigError, match=str(path)):
            load_config(path)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.name)
def test_every_shipped_config_loads_and_its_bus_is_within_budget(path: Path) -> None:
    from invid.planning import make_plan

    plan = make_plan(load_config(path))
    assert plan.duration_s > 0
    assert plan.budget.load <= plan.budget.max_load


@pytest.mark.parametrize(
    ("old", "new", "value", "right"),
    [
        ("torque_Nm: 20", "torque_mNm", 20000, "torque_Nm (force_N where motion is linear)"),
        ("torque_Nm: 20", "Torque_nm", 20, "torque_Nm (force_N where motion is linear)"),
        ("position_window_rad: 0.1", "position_window", 0.1, "position_window_rad (position_window_m where"),
        ("velocity_rad_per_s: 1}", "velocity_rpm", "10}", "velocity_rad_per_s (velocity_m_per_s where"),
        ("node_id: 2", "inertia_gcm2", "70\n    node_id: 2", "inertia_kgm2 (mass_kg where motion is linear)"),
        ("channel: x", "cycle_ms", "2, channel: x", "cycle_s"),
    ],
)
def test_a_wrong_or_missing_unit_is_told_with_the_key_found_and_the_right_one(
    old: str, new: str, value: object, right: str
) -> None:
    before, _, after = GOOD.rpartition(old)
    said = message(f"{before}{new}: {value}{after}")
    assert f".{new} is no key of a config here" in said
    assert f"write {right}" in said
    assert "the value in that unit" in said
    assert "is missing" not in said


CELL = """
format: invid-config
robot: heartbeat
bus: {{interface: none, channel: none, cycle_s: {cycle}, bitrate_bit_per_s: {bitrate}}}
axes: [{axes}]
safety: {safety}
"""
AXIS = "{{name: A{i}, node_id: {i}, limits: {{torque_Nm: 1, position_window_rad: 1, velocity_rad_per_s: 1}}}}"


def cell(cycle: float = 0.001, bitrate: int = 1_000_000, axes: int = 1, safety: str = "{}") -> CellConfig:
    many = ", ".join(AXIS.format(i=i + 1) for i in range(axes))
    return parse_config(CELL.format(cycle=cycle, bitrate=bitrate, axes=many, safety=safety))


@pytest.mark.parametrize(
    ("cycle", "axes", "bitrate"),
    [
        (0.001, 1, 1_000_000),
        (0.001, 3, 1_000_000),
        (0.002, 6, 1_000_000),
        (0.002, 2, 500_000),
        (0.004, 1, 125_000),
        (0.004, 3, 250_000),
    ],
)
@pytest.mark.parametrize("skipped", [5, 20])
def test_the_watch_outlasts_the_longest_pause_that_is_forgiven_and_the_bus_carries_it(
    cycle: float, axes: int, bitrate: int, skipped: int
) -> None:
    config = cell(cycle, bitrate, axes, f"{{overrun_cycles: {skipped}}}")
    assert bus_budget(config).fits
    beat = config.safety.heartbeat_s
    assert 3 * beat - beat >= (skipped + 3) * cycle or beat == 0.1
    shorter = config.model_copy(
        update={"safety": config.safety.model_copy(update={"heartbeat_s": beat - 0.001})}
    )
    forgives = 2 * (beat - 0.001) >= (skipped + 3) * cycle
    assert not forgives or not bus_budget(shorter).fits or beat == 0.1


def test_a_slow_cycle_keeps_the_longest_heartbeat_and_one_that_a_user_sets_is_kept() -> None:
    assert cell(0.02).safety.heartbeat_s == 0.1
    assert cell().safety.heartbeat_s == 0.012
    assert cell(safety="{heartbeat_s: 0.1}").safety.heartbeat_s == 0.1
    again = CellConfig.model_validate(cell().model_dump(mode="json"))
    assert again.safety.heartbeat_s == 0.012
