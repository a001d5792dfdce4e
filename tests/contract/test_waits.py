"""Every wait ends in a stated time, at the way out; judged on drives and plant of another author."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from durand.services.sdo.server import SDODomainAbort
from other_cell import CYCLE, OtherCell

from invid.errors import DriveError, RecordingError, SafetyStop, left_by
from invid.recording import Outcome
from invid.sweep import Mode
from invid_drivers.cia402.axis_state import ENABLE_S
from invid_drivers.cia402.bus import STOPPED_S, Cia402Cell
from invid_drivers.cia402.cycle_requests import CHANGE_S
from invid_drivers.cia402.link import HEARD_S
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import remembered
from invid_drivers.cli.measure import stop_on_signals
from invid_drivers.measurement import run_measurement

LOADED = {"gravity": 5.0, "values": {"0x605A": 6}}
"""5 N·m of 10 rated; the drive stays in quick stop active."""


def energise_held(cell: OtherCell, master: Cia402Cell) -> None:
    master.check()
    master.energise([Mode.HOLD] * len(cell.drives))


def refuse_modes(drive: Any, when: set[str]) -> None:
    """The drive takes 0x6060 only in other states than these."""

    def validate(value: int) -> None:
        if drive.state in when:
            raise SDODomainAbort(0x08000022, (0x6060, 0))

    drive.od.validate_callbacks[(0x6060, 0)].add(validate)


@pytest.fixture
def cell(tmp_path: Path) -> OtherCell:
    loads = [{"gravity_loaded": True}, {"gravity_loaded": False}]
    return OtherCell(tmp_path, [LOADED, {}], loads)


def left_held(cell: OtherCell) -> None:
    """A run that ended as it began: A1 is held by its drive, in the mode of the way out."""
    master = cell.connect()
    energise_held(cell, master)
    master.secure([True, False])
    master.close()
    assert cell.drives[0].state == "quick stop active"


def test_a_held_drive_that_takes_no_mode_in_quick_stop_is_refused_and_goes_on_holding(
    cell: OtherCell,
) -> None:
    left_held(cell)
    cell.drives[0].od.write(0x6061, 0, 10)  # as after a stop in torque mode
    refuse_modes(cell.drives[0], {"quick stop active"})
    began, place = cell.bus.time, cell.drives[0].axis.x[0]
    master = cell.connect()
    with pytest.raises(DriveError, match="takes no other there") as refused:
        energise_held(cell, master)
    assert refused.value.axis == "A1"
    assert "A1" in " ".join(master.close())
    assert cell.drives[0].state == "quick stop active"
    assert abs(cell.drives[0].axis.x[0] - place) < 0.005
    assert cell.bus.time - began < 30.0


def test_a_held_drive_that_takes_no_mode_in_quick_stop_but_has_the_right_one_is_taken_over(
    cell: OtherCell,
) -> None:
    left_held(cell)
    refuse_modes(cell.drives[0], {"quick stop active"})
    assert cell.drives[0].number(0x6061) == 8
    began, place = cell.bus.time, cell.drives[0].axis.x[0]
    master = cell.connect()
    master.cancelled = lambda: cell.bus.time > began + 30.0
    energise_held(cell, master)
    assert [d.state for d in cell.drives] == ["operation enabled"] * 2
    assert abs(cell.drives[0].axis.x[0] - place) < 0.005
    master.close()


def test_a_mode_that_never_comes_ends_the_way_to_operation(cell: OtherCell) -> None:
    """A drive that enables without stopping in switched on, from which it would take its mode."""
    drive = cell.drives[1]
    drive.od.write(0x6061, 0, 8)
    refuse_modes(drive, {"switch on disabled", "ready to switch on", "operation enabled"})
    enter = drive.enter
    drive.enter = lambda state: enter("operation enabled" if state == "switched on" else state)
    master = cell.connect()
    master.check()
    began = cell.bus.time
    master.cancelled = lambda: cell.bus.time > began + 30.0
    with pytest.raises(DriveError, match=r"without its mode|was refused") as refused:
        master.energise([Mode.HOLD] * 2)
    assert refused.value.axis == "A2"
    assert cell.bus.time - began < ENABLE_S + CHANGE_S + 2.0
    master.close()
    assert drive.state == "switch on disabled"


@pytest.mark.parametrize("late", [0.6, 1.7])
def test_a_computer_that_is_always_late_sends_sync_and_heartbeat_and_ends_the_run(
    cell: OtherCell, late: float
) -> None:
    master = cell.connect()
    energise_held(cell, master)
    bus, sleep = cell.bus, cell.bus.clock.sleep_until
    bus.clock.sleep_until = lambda instant: sleep(instant + late * CYCLE)
    bus.at.append((bus.time + 5.0, lambda: pytest.fail("no SYNC for seconds")))
    began = bus.time
    with pytest.raises(SafetyStop) as stopped:
        master.exchange([0.0, 0.0])
    assert stopped.value.code == "computer_late"
    bus.at.clear()
    pause = bus.time - began
    assert pause < (master._config.safety.overrun_cycles + 4) * CYCLE * (1 + late)
    syncs = [t for t, cob, _ in bus.sent if cob == 0x80]
    assert min(b - a for a, b in pairwise(syncs)) >= 0.5 * CYCLE
    assert [
        t for t, cob, _ in bus.sent if cob == 0x77F and t > began
    ] or pause < master._config.safety.heartbeat_s
    master.close()
    assert [d.state for d in cell.drives] == ["quick stop active", "switch on disabled"]
    assert abs(cell.drives[0].axis.x[0]) < 0.02


def test_a_stop_is_heard_at_once_in_the_silence_of_the_stop_test(tmp_path: Path) -> None:
    """A heartbeat of 5 s makes a silence of 22.7 s."""
    cell = OtherCell(tmp_path, [LOADED], [{"gravity_loaded": True}], heartbeat_s=5.0)
    master = cell.connect()
    energise_held(cell, master)
    asked: list[float] = []
    master.cancelled = lambda: bool(asked)

    def ask_in_silence() -> None:
        last = max(t for t, cob, _ in cell.bus.sent if cob == 0x80)
        if cell.bus.time - last > 1.0:
            asked.append(cell.bus.time)
        else:
            cell.bus.at.append((cell.bus.time + 0.1, ask_in_silence))

    cell.bus.at.append((cell.bus.time, ask_in_silence))
    with pytest.raises(SafetyStop, match="on request"):
        master.secure([True])
    assert cell.bus.time - asked[0] < HEARD_S + 0.01
    master.stop()
    back = min(t for t, cob, _ in cell.bus.sent if cob == 0x201 and t > asked[0])
    assert back - asked[0] < HEARD_S + 0.05
    assert master.held_at_end == ("A1",)
    master.close()
    assert cell.drives[0].state == "quick stop active"
    assert abs(cell.drives[0].axis.x[0]) < 0.02


def test_a_stop_is_heard_while_a_drive_that_answers_slowly_is_prepared(cell: OtherCell) -> None:
    master = cell.connect()
    master.check()
    arrive = cell.bus.arrive
    cell.bus.arrive = lambda cob, data: None if cob & 0x780 == 0x580 else arrive(cob, data)
    asked = cell.bus.time + 0.5
    master.cancelled = lambda: cell.bus.time > asked
    with pytest.raises(SafetyStop, match="on request"):
        master.energise([Mode.HOLD] * 2)
    assert cell.bus.time - asked < HEARD_S + 0.01
    cell.bus.arrive = arrive
    master.close()


def test_the_axes_of_an_error_are_remembered_and_no_number_in_its_words(tmp_path: Path) -> None:
    cell = OtherCell(tmp_path, [LOADED, {}], [{"name": "1", "gravity_loaded": True}, {"name": "2"}])
    master = cell.connect()
    energise_held(cell, master)
    master.suspect(SafetyStop("axis 2: moved by 0.1 rad", axis="2"))
    assert [bool(h.seen.suspect) for h in master.holdings] == [False, True]
    master.close()


class Failing:
    """A sink whose file fails in the first row, and again when it is closed."""

    def begin(self, *_: Any) -> None:
        pass

    def row(self, *_: Any) -> None:
        raise ZeroDivisionError("a fault of this program")

    def end(self) -> None:
        pass

    def close(self, _: Outcome) -> None:
        raise RecordingError("rec.h5: cannot be closed")


def test_an_error_that_nobody_expected_carries_what_could_not_be_restored(cell: OtherCell) -> None:
    master = cell.connect()
    master.check()

    def refuse(value: int) -> None:
        if cell.drives[1].state == "switch on disabled" and value == 10_000:
            raise SDODomainAbort(0x08000021, (0x6072, 0))

    cell.drives[1].od.validate_callbacks[(0x6072, 0)].add(refuse)
    with pytest.raises(ZeroDivisionError) as failed:
        run_measurement(
            cell.config, cell.plan(), master, cell.folder / "rec.h5", open_sink=lambda _: (Failing(), ())
        )
    left = " ".join(left_by(failed.value))
    assert "axis A1 is energised" in left
    assert "0x6072" in left
    assert "cannot be closed" in left


@pytest.mark.parametrize("loaded", [True, False])
def test_who_stops_at_once_is_told_which_axes_stay_energised(tmp_path: Path, loaded: bool) -> None:
    cell = OtherCell(tmp_path, [LOADED if loaded else {}], [{"gravity_loaded": loaded}])
    master = cell.connect()
    plan = cell.plan()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    sink = Failing()
    sink.row, sink.close = interrupt, lambda _: None  # type: ignore[method-assign]
    with pytest.raises(SafetyStop, match="stopped at once on request") as stopped, stop_on_signals():
        run_measurement(cell.config, plan, master, cell.folder / "rec.h5", open_sink=lambda _: (sink, ()))
    assert cell.drives[0].state == ("quick stop active" if loaded else "switch on disabled")
    assert ("axis A1 is energised" in str(stopped.value)) is loaded
    assert ("it left no axis under power" in str(stopped.value)) is not loaded


@pytest.mark.parametrize("slow", ["answers", "mute", "ramp"])
def test_the_way_out_ends_in_its_stated_time_whatever_drives_do(tmp_path: Path, slow: str) -> None:
    """SDO answers of 0.9 s, none at all, a quick stop of a minute from 3 rad/s: off or held, and closed."""
    ramp = {"values": {"0x6085": 1000, "0x6084": 1000}} if slow == "ramp" else {}
    cell = OtherCell(tmp_path, [ramp] * 6, [{"gravity_loaded": False}] * 6)
    master, bus = cell.connect(), cell.bus
    master.check()
    master.energise([Mode.TORQUE] * 6)
    for _ in range(10):
        master.exchange([0.0] * 6)
    for drive in cell.drives:
        drive.axis.v[0] = 1.0 if slow == "ramp" else 0.0
    arrive = bus.arrive

    def late(cob: int, data: bytes) -> None:
        if slow != "ramp" and cob & 0x780 == 0x180:
            return
        if slow == "answers" and cob & 0x780 == 0x580:
            bus.at.append((bus.time + 0.9, lambda: arrive(cob, data)))
            bus.at.sort(key=lambda e: e[0])
        elif slow != "mute" or cob & 0x780 != 0x580:
            arrive(cob, data)

    bus.arrive = late
    began = bus.time
    said = master.close()
    assert bus.time - began < STOPPED_S
    assert {d.state for d in cell.drives} == {"switch on disabled"}
    assert bool(said) is (slow != "ramp")


def test_a_run_that_is_killed_leaves_that_its_axes_may_be_energised(cell: OtherCell) -> None:
    master = cell.connect()
    energise_held(cell, master)
    memory = HoldMemory.beside(cell.folder / "bus.journal")  # as another process reads it after kill -9
    found = remembered(cell.config, memory)
    assert [(r.axis, r.code, r.taken_over) for r in found] == [
        ("A1", "axis_energised", True), ("A2", "axis_energised", True),
    ]  # fmt: skip
    assert all("may be energised" in r.text and r.at is not None for r in found)
    master.secure([True, False])
    master.close()
    left = remembered(cell.config, HoldMemory.beside(cell.folder / "bus.journal"))
    assert ["its drive holds it" in r.text for r in left] == [True]
    cell.drives[0].enter("switch on disabled")
    assert cell.check() == ""
    assert remembered(cell.config, HoldMemory.beside(cell.folder / "bus.journal")) == ()
