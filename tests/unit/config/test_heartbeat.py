"""The heartbeat that a config leaves open: the shortest that cycle, bus and what is forgiven allow."""

import pytest

from invid.config import CellConfig, parse_config
from invid.planning import bus_budget

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
