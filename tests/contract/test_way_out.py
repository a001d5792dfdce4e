"""The way out when something stands in it: late answers, silent drives, drives that do not obey, a second
Ctrl-C. Judged on the drives themselves, not on what the master believes."""

import contextlib
from collections.abc import Callable
from typing import Any

import pytest
from stepping import energise, exchange, set_modes
from test_adapter_promises import config, held, simulated, zero

from invid.errors import DriveError, SafetyStop
from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Entry
from invid_drivers.connect import connect
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

OFF = {"SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "FAULT", "NOT_READY_TO_SWITCH_ON"}


def drives_of(cell: Cia402Cell) -> Any:
    bus: Any = cell._link.bus
    return bus.cell.drives


def without(cell: Cia402Cell, lost: Callable[[int], bool]) -> Callable[[float], Any]:
    """The link's ``get`` when frames of some identifiers never reach the master."""
    get = cell._link.get

    def heard(timeout: float) -> Any:
        message = get(timeout)
        return None if message is not None and lost(message.arbitration_id) else message

    return heard


def running(cell: Cia402Cell) -> None:
    cell.check()
    energise(cell, held(cell))
    set_modes(cell, [Mode.TORQUE, Mode.HOLD])
    for _ in range(20):
        exchange(cell, zero(cell))


def exchanged(cell: Cia402Cell, cycles: int) -> None:
    for _ in range(cycles):
        exchange(cell, zero(cell))


def test_a_drive_whose_samples_are_lost_but_that_answers_is_switched_off_and_known_to_be() -> None:
    cell = simulated()
    drives = drives_of(cell)
    try:
        running(cell)
        cell._link.get = without(cell, lambda cob: cob == 0x181)  # type: ignore[method-assign]
        cell.stop()
        assert {d.state.name for d in drives} <= OFF
        assert cell.not_off == ()
    finally:
        assert cell.close() == []


def test_a_drive_that_obeys_nothing_keeps_its_heartbeat_watch_which_stops_it() -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    cell = Cia402Cell(bus, cfg)
    drive = bus.cell.drives[0]
    running(cell)
    drive.ignore_controlword = True
    said = cell.close()
    assert cell.not_off == ("A1",)
    assert any("A1" in line and "heartbeat watch" in line for line in said)
    assert drive.node.od.number(0x1016, 1) != 0
    assert cell.journal.of_node(1)
    assert not cell.journal.of_node(2)
    bus.clock.sleep_until(bus.clock.now() + 2.0)
    assert drive.state.name in OFF


def test_a_silent_drive_that_hears_is_told_to_switch_off() -> None:
    """Nothing of it arrives any more, not even heartbeats; what is sent to it does."""
    cell = simulated()
    drives = drives_of(cell)
    running(cell)
    cell._link.get = without(cell, lambda cob: cob & 0x7F == 1)  # type: ignore[method-assign]
    cell.stop()
    assert cell.not_off == ("A1",)
    assert {d.state.name for d in drives} <= OFF
    cell.close()


def test_a_stop_while_the_brakes_open_does_not_wait_for_them() -> None:
    cell = simulated()
    drives = drives_of(cell)
    clock = cell._link.clock
    shown: list[str] = []

    def cancelled() -> bool:
        shown.extend(d.state.name for d in drives)
        return "SWITCHED_ON" in shown

    cell.cancelled = cancelled
    try:
        cell.check()
        began = clock.now()
        with pytest.raises(SafetyStop, match="nothing was recorded"):
            energise(cell, held(cell))
        assert "OPERATION_ENABLED" not in shown
        cell.stop()
        assert clock.now() - began < 1.0
        assert {d.state.name for d in drives} <= OFF
        assert cell.not_off == ()
    finally:
        assert cell.close() == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_neither_a_second_ctrl_c_nor_a_fault_in_the_quick_stop_leaves_a_drive_on(
    error: type[BaseException],
) -> None:
    cell = simulated()
    drives = drives_of(cell)
    running(cell)
    for _ in range(100):
        exchange(cell, [4.0, 0.0])  # to 0.8 rad/s: a quick stop takes its time
    cycle, errors = cell._cycle.exchange, [error]

    def interrupted(torque: Any) -> Any:
        if errors:
            raise errors.pop()
        return cycle(torque)

    cell._cycle.exchange = interrupted  # type: ignore[method-assign]
    with contextlib.suppress(KeyboardInterrupt):
        cell.stop()
    assert not errors
    assert cell.close() == []
    assert {d.state.name for d in drives} <= OFF
    assert cell.not_off == ()


def test_a_drive_put_in_place_of_another_does_not_get_the_others_values() -> None:
    """The other's values wait in the journal, and are told, until the other is back."""
    cell = simulated()
    try:
        cell.check()
        drive = drives_of(cell)[0]
        serial = drive.node.od.number(0x1018, 4)
        assert serial
        before = drive.node.od.number(0x6072)
        wrote = f"{before:04x}"
        wrote = wrote[2:] + wrote[:2]
        of_another = Entry(1, serial + 1, 0x6072, 0, "0b00", wrote)
        for entry in (of_another, Entry(2, cell.drives[1].serial, 0x6072, 0, "0b00", wrote)):
            cell.journal.add(entry)
        reports = cell.check()
        assert drive.node.od.number(0x6072) == before
        assert drives_of(cell)[1].node.od.number(0x6072) == 11
        assert cell.journal.entries == (of_another,)
        (said,) = reports[0].warnings
        assert f"serial number {serial + 1}" in said
    finally:
        cell.close()


def test_a_cell_that_is_refused_leaves_the_bus_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = []
    shutdown = VirtualTimeBus.shutdown
    monkeypatch.setattr(VirtualTimeBus, "shutdown", lambda bus: (closed.append(bus), shutdown(bus)))
    with pytest.raises(DriveError, match="not in the table"):
        connect(config(vendor="nobody"))
    assert len(closed) == 1


def test_a_drive_whose_heartbeat_stays_away_is_reported_though_its_samples_come() -> None:
    cell = simulated()
    get = cell._link.get
    try:
        running(cell)
        for _ in range(100):  # 0.2 s: two periods
            assert exchange(cell, zero(cell)).events == []
        cell._link.get = without(cell, lambda cob: cob == 0x701)  # type: ignore[method-assign]
        with pytest.raises(DriveError, match=r"axis A1.*no heartbeat"):
            exchanged(cell, 300)
    finally:
        cell._link.get = get  # type: ignore[method-assign]
        cell.close()


def test_every_change_of_an_axis_is_told_as_it_is_and_the_last_one_is_how_it_was_left() -> None:
    cell = simulated()
    told: list[dict[str, str]] = []
    cell.seen = told.append
    running(cell)
    assert told[-1] == {"A1": "led by this master", "A2": "held by its drive"}
    assert cell.close() == []
    assert told[-1] == cell.axis_states == {"A1": "without torque", "A2": "without torque"}
