"""Simulated drives with the habits of real ones: each does what its option says, judged on the plant."""

from __future__ import annotations

import math
from typing import Any

import pytest
from node_master import Master, cell

from invid_drivers.simulated import VirtualTimeBus
from invid_drivers.simulated.injection import OTHER_MASTER_ID
from invid_drivers.simulated.node import Nmt

OE, QSA = 0x27, 0x07
COUNTS = 524288 / (2 * math.pi)


def started(mode: int = 10, enable: bool = True, faults: list[dict[str, Any]] = (), **axis: Any) -> Master:  # type: ignore[assignment]
    master = Master(cell({"axes": {"A1": axis}, "faults": list(faults)}))
    master.prepare(mode=mode)
    if enable:
        master.enable()
    return master


def place(master: Master) -> float:
    return float(master.bus.cell.plant.positions[0])


def test_a_loaded_axis_stands_on_its_prop_until_its_drive_has_held_it_and_falls_without_both() -> None:
    master = started(mode=8, enable=False, brake=False, load={"torque_Nm": 5.0})
    master.bus.clock.sleep_until(0.5)
    assert place(master) == pytest.approx(0.0, abs=1e-6)
    master.next_sync = 0.6
    master.enable()
    for _ in range(300):
        master.cycle([0], 0x0F)
    assert abs(place(master)) < 0.001
    for _ in range(200):
        master.cycle([0], 0x00)
    # 5 N·m on 1 kg·m² for 0.2 s
    assert place(master) == pytest.approx(-0.5 * 5.0 * 0.2**2, rel=0.05)
    master.bus.cell.drives[0].brake.prop()
    master.wait(0.3)
    here = place(master)
    master.wait(0.3)
    assert place(master) == pytest.approx(here, abs=1e-6)
    master.close()


@pytest.mark.parametrize("unit", ["counts_per_s2", "rpm_per_s"])
def test_a_quick_stop_takes_the_way_of_its_ramp_whatever_counts_it(unit: str) -> None:
    master = started(limits_in_torque_mode=False, quick_stop_deceleration_rad_per_s2=2.0, ramp_unit=unit)
    expected = 2.0 * COUNTS if unit == "counts_per_s2" else 2.0 * 60 / (2 * math.pi)
    assert master.read(1, 0x6085) == round(expected)
    master.next_sync = round(master.bus.clock.now() + 0.002, 3)
    for _ in range(100):
        master.cycle([100], 0x0F)  # 10 N·m on 1 kg·m² for 0.1 s: 1 rad/s
    before, speed = place(master), float(master.bus.cell.plant.velocities[0])
    for _ in range(800):
        master.cycle([0], 0x0B)
    assert place(master) - before == pytest.approx(speed**2 / (2 * 2.0), rel=0.07)  # and what the loop lags
    master.close()


def test_another_masters_frames_reach_master_and_drives() -> None:
    speech = [
        {"kind": "other_master", "axis": "A1", "at_s": 0.1, "traffic": kind, "period_s": 0.01,
         "duration_s": 0.1, "value": 128}
        for kind in ("sync", "nmt", "sdo", "heartbeat")
    ]  # fmt: skip
    master = started(enable=False, faults=speech)
    heard = [f[1] for f in master.wait(0.5)]
    for can_id in (0x80, 0x000, 0x601, 0x700 + OTHER_MASTER_ID):
        assert 9 <= heard.count(can_id) <= 11, hex(can_id)
    assert master.bus.cell.drives[0].node.state is Nmt.PRE_OPERATIONAL
    master.close()


def test_a_foreign_node_is_operational_and_notes_whoever_changes_that() -> None:
    master = Master(cell({"foreign_nodes": [9], "foreign_heartbeat_s": 0.1}))
    node = master.bus.cell.foreign[0]
    assert node.state is Nmt.OPERATIONAL
    assert len([f for f in master.wait(1.0) if f[1] == 0x709]) >= 9
    assert node.nmt_changes == []
    bus: VirtualTimeBus = master.bus
    bus.send_raw(0, b"\x80\x01")
    master.wait(0.01)
    assert node.nmt_changes == []
    bus.send_raw(0, b"\x80\x00")
    bus.send_raw(0, b"\x81\x09")
    master.wait(0.05)
    assert node.nmt_changes == [Nmt.PRE_OPERATIONAL, Nmt.INITIALISING]
    master.close()
