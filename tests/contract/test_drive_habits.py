"""Habits of drives that people report, each of which ended a measurement after `check` had said "ready"."""

from typing import Any

import pytest
from stepping import energise, exchange, set_modes
from test_adapter_promises import config, held, zero

from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.simulated import open_virtual_bus
from invid_drivers.simulated.object_dictionary import SdoAbort

NO_RTR = 0x40000181
HABITS: dict[str, dict[str, Any]] = {
    "bit 30 of the TPDO stays": {"objects": {"values": {"0x1800:1": NO_RTR}}},
    "0x6061 is 0 until enabled": {"mode_shown_enabled": True},
    "0x6060 from switched on": {"mode_from_switched_on": True},
    "both": {"mode_shown_enabled": True, "mode_from_switched_on": True, "enable_s": 0.4},
    "0x6502 missing": {"objects": {"lacks": ["0x6502"]}},
    "0x6502 missing, 0x6061 late": {"objects": {"lacks": ["0x6502"]}, "mode_display_s": 0.8},
}


@pytest.mark.parametrize("habit", list(HABITS))
def test_a_drive_with_a_habit_is_enabled_held_shaken_and_left_as_it_was(habit: str) -> None:
    cfg = config({"axes": {"A1": HABITS[habit]}})
    bus = open_virtual_bus(cfg)
    cell = Cia402Cell(bus, cfg)
    drive = bus.cell.drives[0]
    before = {(e.index, e.sub): e.value for e in drive.node.od if e.access == "rw" and e.index != 0x1003}
    cell.check()
    energise(cell, held(cell))
    assert drive.mode == 8
    set_modes(cell, [Mode.TORQUE, Mode.HOLD])
    while cell.changing:
        exchange(cell, zero(cell))
    assert drive.mode == 10
    for _ in range(20):
        exchange(cell, [1.0, 0.0])
    bus.cell.plant.advance_to(bus.cell.now_ns)
    assert bus.cell.plant.velocities[0] > 0.0
    assert cell.close() == []
    after = {at: drive.node.od.number(*at) for at in before if at[0] not in (0x6040, 0x6060, 0x6071, 0x607A)}
    assert after == {at: before[at] for at in after}


def test_a_drive_without_0x6502_that_refuses_cyclic_torque_is_tried_with_profile_torque() -> None:
    cfg = config({"axes": {"A1": {"objects": {"lacks": ["0x6502"]}}}})
    bus = open_virtual_bus(cfg)
    od = bus.cell.drives[0].node.od
    taken = od.entry(0x6060).on_write

    def fewer(value: int) -> None:
        if value == 10:
            raise SdoAbort(SdoAbort.RANGE)
        taken(value)

    od.guard(0x6060, 0, fewer)
    cell = Cia402Cell(bus, cfg)
    report = cell.check()[0]
    assert report.torque_mode.name == "PROFILE_TORQUE"
    assert report.can_hold
    cell.close()
