"""How drives stop: what is asked of them, what is written, and the ways that the plant then takes."""

from typing import Any

import numpy as np
import pytest
import yaml
from stepping import energise

from benchmarks.drivers.bench_stopping import TIMER, Run, cell_config, draw
from invid.config import CellConfig, parse_config
from invid.errors import ConfigError, DriveError
from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.stated.vendors import VENDORS
from invid_drivers.connect import connect
from invid_drivers.readiness import ask
from invid_drivers.stopping_budgets import plan_within

TIMED = VENDORS.pop(TIMER)
"""The benchmark's own drive: in the table only while a test of this file runs."""

COUNTS = 524288
RAD = COUNTS / (2 * np.pi)


@pytest.fixture(autouse=True)
def timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(VENDORS, TIMER, TIMED)


def cell(drive: dict[str, Any] | None = None, /, *, safety: Any = None, **axis: Any) -> CellConfig:
    limits = {"torque_Nm": 25, "position_window_rad": 0.5, "velocity_rad_per_s": 3}
    return parse_config(
        yaml.safe_dump(
            {
                "format": "invid-config",
                "robot": "one axis",
                "bus": {"interface": "invid-virtual", "channel": "stopping"},
                "axes": [
                    {
                        "name": "A1",
                        "node_id": 1,
                        "rated_torque_Nm": 50,
                        "inertia_kgm2": 2.0,
                        "limits": limits,
                        "gravity_loaded": False,
                    }
                    | axis
                ],
                "safety": safety or {"heartbeat_s": 0.02},
                "simulation": {
                    "plant": {"branches": [{"axis": "A1", "masses": [1.5, 0.5], "springs": [2000.0]}]},
                    "axes": {"A1": {"encoder_counts_per_rev": COUNTS} | (drive or {})},
                },
            }
        )
    )


def od_of(master: Cia402Cell) -> Any:
    bus: Any = master._link.bus
    return bus.cell.drives[0].node.od


def test_a_config_that_states_a_steeper_ramp_has_it_written_where_its_unit_is_known_and_restored() -> None:
    axis = {
        "vendor": "epos4",
        "position_rad_per_count": 2 * np.pi / COUNTS,
        "quick_stop_deceleration_rad_per_s2": 8,
    }
    drive = {
        "quick_stop_deceleration_rad_per_s2": 1.0, "ramp_unit": "rpm_per_s",
        "objects": {"profile": "epos4", "values": {"0x3001:1": 3000, "0x3001:2": 3000}},
    }  # fmt: skip
    master = connect(cell(drive, **axis))
    (report,) = master.check()
    assert report.stopping.deceleration == pytest.approx(8.0)
    before = od_of(master).number(0x6085)
    energise(master, [Mode.HOLD])
    assert od_of(master).number(0x6085) == pytest.approx(8 * 60 / (2 * np.pi), abs=1)
    od = od_of(master)
    assert master.close() == []
    assert od.number(0x6085) == before


def test_a_ramp_beyond_the_torque_limit_is_given_what_the_limit_can_do_and_restored() -> None:
    config = cell({"quick_stop_deceleration_rad_per_s2": 100.0})
    master = connect(config)
    (report,) = master.check()
    assert report.stopping.deceleration == pytest.approx(0.8 * 25 / 2.0)
    od, before = od_of(master), od_of(master).number(0x6085)
    energise(master, [Mode.HOLD])
    assert od.number(0x6085) == pytest.approx(10.0 * RAD, rel=1e-4)
    assert master.close() == []
    assert od.number(0x6085) == before


def test_the_event_timer_of_the_rpdo_is_written_longer_than_what_is_forgiven_and_restored() -> None:
    master = connect(cell())
    od = od_of(master)
    energise(master, [Mode.HOLD])
    assert od.number(0x1400, 5) == 23  # 20 cycles that a late computer may skip, and three
    assert master.close() == []
    assert od.number(0x1400, 5) == 0


@pytest.mark.parametrize("found", [10, 60])
def test_an_event_timer_is_only_ever_tightened(found: int) -> None:
    master = connect(cell())
    od = od_of(master)
    od.put(0x1400, 5, found)
    energise(master, [Mode.HOLD])
    assert od.number(0x1400, 5) == min(found, 23)
    master.close()
    assert od.number(0x1400, 5) == found


def test_an_event_timer_that_the_cycle_cannot_keep_is_refused_with_the_way_out() -> None:
    master = connect(cell())
    od_of(master).put(0x1400, 5, 1)
    with pytest.raises(DriveError, match=r"A1.*0x1400:5.*1 ms.*bus.cycle_s"):
        master.check()
    master.close()


def test_a_slow_heartbeat_is_refused_before_motion_with_the_way_out() -> None:
    with pytest.raises(ConfigError, match=r"A1.*even from rest.*0x1016.*shorten safety.heartbeat_s"):
        ask(cell(safety={"heartbeat_s": 0.5})).require()


def test_a_run_keeps_the_speed_that_was_permitted() -> None:
    config = cell({"quick_stop_deceleration_rad_per_s2": 1.0})
    master = connect(config)
    found = plan_within(config, master.check())
    assert found.plan.forecast[0].velocity <= found.budgets[0].permitted
    master.close()


@pytest.mark.parametrize("how", ["stop", "dead master"])
@pytest.mark.parametrize("number", range(4))
def test_no_way_of_the_plant_is_longer_than_what_was_stated(number: int, how: str) -> None:
    d = draw(np.random.default_rng([7, number]))
    run = Run(cell_config(d, number), d)
    budget = run.budget()
    stated = budget.stop if how == "stop" else budget.dead_master
    assert stated is not None
    true = run.way(how)
    run.master.close()
    assert 0.05 * stated < true <= stated
