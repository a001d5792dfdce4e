"""What the link promises from its first frame to its last, on drives of another hand; every wait ends in a
stated time, at the way out.

What drives, loads, computers and persons do meanwhile: `test_foreign_kinds.py`.
"""

import os
import threading
from pathlib import Path
from typing import Any

import pytest
from foreign_bus import LOADED, ForeignCell
from stepping import energise, exchange, secure, set_modes

from invid.errors import BusError, DriveError, RecordingError, SafetyStop, left_by
from invid.recording import Outcome
from invid.sweep import Mode
from invid.sweep.ports import Loop
from invid_drivers.cia402.bus import STOPPED_S, Cia402Cell
from invid_drivers.cia402.link import HEARD_S
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import remembered
from invid_drivers.cli.measure import stop_on_signals
from invid_drivers.measurement import run_measurement
from tests.machines.foreign.habits import GivesLess

NOTHING: dict[str, Any] = {}


def energised(cell: ForeignCell) -> Cia402Cell:
    """A master that holds every axis."""
    master = cell.connect()
    master.check()
    energise(master, [Mode.HOLD] * len(cell.bus.axes))
    return master


@pytest.fixture
def cell(tmp_path: Path) -> ForeignCell:
    return ForeignCell(tmp_path, [LOADED, NOTHING], [True, False])


def test_the_journal_of_a_killed_run_gives_no_right_to_a_node_that_another_master_drives_now(
    tmp_path: Path,
) -> None:
    cell = ForeignCell(tmp_path, [NOTHING], [False])
    killed = energised(cell)
    assert killed.journal.entries
    (axis,) = cell.bus.axes
    cell.bus.sleep_until(cell.bus.now() + 1.0)  # nobody restores, and the drive has stopped by itself
    axis.enter("enabled", "by its new master")
    cell.bus.sent.clear()
    cell.bus.world.other_master = cell.bus.now()
    again = cell.connect()
    with pytest.raises(BusError, match="nothing was sent"):
        again.check()
    again.close()
    assert cell.bus.sent == []
    assert axis.state == "enabled"


def test_no_disk_is_waited_for_while_an_axis_is_energised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = ForeignCell(tmp_path, [LOADED], [True])
    flushed: list[tuple[bool, bool]] = []
    fsync = os.fsync

    def slow(file: int) -> None:
        powered = any(a.is_powered for a in cell.bus.axes)
        flushed.append((threading.current_thread() is threading.main_thread(), powered))
        fsync(file)

    monkeypatch.setattr(os, "fsync", slow)
    # On a bus in real time another process writes the recording; here only what the link writes is judged.
    monkeypatch.setattr("invid.recording.spool.sync_folder", lambda folder: None)
    monkeypatch.setattr("invid.recording.writer.put_in_place", lambda rows, target, outcome: None)
    run_measurement(cell.config, cell.plan(), cell.connect(), cell.folder / "rec.h5")
    seen = HoldMemory.beside(cell.folder / "bus.journal").of_axis(1)
    assert seen is not None
    assert (seen.loaded, seen.holds, seen.resumes, seen.left_held) == (True, True, True, True)
    assert any(powered for _, powered in flushed)
    assert not any(main for main, _ in flushed)


@pytest.mark.parametrize("damage", ["", "[]"])
def test_with_a_damaged_memory_no_axis_is_enabled_until_a_person_has_cleared_it(
    tmp_path: Path, damage: str
) -> None:
    cell = ForeignCell(tmp_path, [NOTHING], [False])
    (tmp_path / "bus.holds.json").write_text(damage, encoding="utf-8")
    with pytest.raises(DriveError, match="--cleared A1"):
        energised(cell)
    assert not any(cob == 0x201 for _, cob, _ in cell.bus.sent)
    cleared = cell.connect()
    cleared.held.clear(["A1"])
    cleared.close()
    energised(cell).close()


def test_a_stop_is_heard_at_once_in_the_silence_of_the_stop_test(tmp_path: Path) -> None:
    """A heartbeat of 5 s makes a silence of 22.7 s."""
    cell = ForeignCell(tmp_path, [LOADED], [True], heartbeat_s=5.0)
    master = energised(cell)
    bus, asked = cell.bus, list[float]()

    def cancelled() -> bool:
        last = max(t for t, cob, _ in bus.sent if cob == 0x80)
        if not asked and bus.now() - last > 1.0:
            asked.append(last + 1.0)
        return bool(asked)

    master.cancelled = cancelled
    with pytest.raises(SafetyStop, match="on request"):
        secure(master, [True])
    assert bus.now() - asked[0] < HEARD_S + 0.01
    master.stop()
    back = min(t for t, cob, _ in bus.sent if cob == 0x201 and t > asked[0])
    assert back - asked[0] < HEARD_S + 0.05
    assert master.held_at_end == ("A1",)
    master.close()
    assert bus.axes[0].state == "stopping"
    assert abs(bus.axes[0].plant.q) < 0.02


def test_a_stop_is_heard_while_a_drive_that_answers_slowly_is_prepared(cell: ForeignCell) -> None:
    master = cell.connect()
    master.check()
    for node in cell.bus.nodes:
        node.answers_sdo = False
    asked = cell.bus.now() + 0.5
    master.cancelled = lambda: cell.bus.now() > asked
    with pytest.raises(SafetyStop, match="on request"):
        energise(master, [Mode.HOLD] * 2)
    assert cell.bus.now() - asked < HEARD_S + 0.01
    for node in cell.bus.nodes:
        node.answers_sdo = True
    master.close()


def test_the_axes_of_an_error_are_remembered_and_no_number_in_its_words(cell: ForeignCell) -> None:
    master = energised(cell)
    master.suspect(SafetyStop("axis 1: moved by 0.1 rad", axis="A2"))
    assert [bool(h.seen.suspect) for h in master.held.holdings] == [False, True]
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


def test_an_error_that_nobody_expected_carries_what_could_not_be_restored(cell: ForeignCell) -> None:
    master = cell.connect()
    master.check()
    axis = cell.bus.axes[1]
    before = axis.number(0x607200)
    axis.refuses = lambda at, value: (  # type: ignore[method-assign]
        0x08000021 if at == 0x607200 and value == before and not axis.is_powered else None
    )
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
    cell = ForeignCell(tmp_path, [LOADED if loaded else NOTHING], [loaded])

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    sink = Failing()
    sink.row, sink.close = interrupt, lambda _: None  # type: ignore[method-assign]
    with pytest.raises(SafetyStop, match="stopped at once on request") as stopped, stop_on_signals():
        run_measurement(
            cell.config, cell.plan(), cell.connect(), cell.folder / "rec.h5", open_sink=lambda _: (sink, ())
        )
    assert cell.bus.axes[0].state == ("stopping" if loaded else "off")
    assert ("axis A1 is energised" in str(stopped.value)) is loaded
    assert ("it left no axis under power" in str(stopped.value)) is not loaded


@pytest.mark.parametrize("slow", ["answers", "mute", "ramp"])
def test_the_way_out_ends_in_its_stated_time_whatever_drives_do(tmp_path: Path, slow: str) -> None:
    """SDO answers of 0.9 s, none at all, a quick stop of ten seconds: off or held, and closed."""
    ramp = {"found": {"608400": 1000, "608500": 1000}} if slow == "ramp" else NOTHING
    cell = ForeignCell(tmp_path, [ramp] * 6, [False] * 6)
    master, bus = cell.connect(), cell.bus
    master.check()
    energise(master, [Mode.TORQUE] * 6)
    for _ in range(10):
        exchange(master, [0.0] * 6)
    for node, axis in zip(bus.nodes, bus.axes, strict=True):
        if slow == "ramp":
            axis.plant.v = 1.0
        else:
            node.publish = lambda *_: None  # type: ignore[method-assign]
            node.sdo_s, node.answers_sdo = 0.9, slow == "answers"
    began = bus.now()
    said = master.close()
    assert bus.now() - began < STOPPED_S
    assert {a.state for a in bus.axes} == {"off"}
    assert bool(said) is (slow != "ramp")


def test_a_run_that_is_killed_leaves_that_its_axes_may_be_energised(cell: ForeignCell) -> None:
    master = energised(cell)

    def found() -> list[Any]:  # as another process reads it after kill -9
        return list(remembered(cell.config, HoldMemory.beside(cell.folder / "bus.journal")))

    assert [(r.axis, r.code, r.taken_over) for r in found()] == [
        ("A1", "axis_energised", True), ("A2", "axis_energised", True),
    ]  # fmt: skip
    assert all("may be energised" in r.text and r.at is not None for r in found())
    secure(master, [True, False])
    master.close()
    assert ["its drive holds it" in r.text for r in found()] == [True]
    cell.bus.axes[0].enter("off", "by hand")
    again = cell.connect()
    again.check()
    assert again.held.not_ready == ()
    again.close()
    assert found() == []


@pytest.mark.parametrize("brake_s", [0.03, 0.1])
@pytest.mark.parametrize(("left", "echoes"), [(0.5, True), (0.5, False), (0.0, True)])
@pytest.mark.parametrize("led", [True, False])
def test_an_axis_that_its_drive_does_not_carry_is_left_to_its_brake_for_as_long_as_that_takes(
    tmp_path: Path, brake_s: float, left: float, *, echoes: bool, led: bool
) -> None:
    """It comes to its brake in motion: the drop of the brake test, from rest, is no measure of it."""
    load = 5.0
    cell = ForeignCell(tmp_path, [{"plant": {"load": load, "brake": brake_s}}], [True])
    master = energised(cell)
    (axis,) = cell.bus.axes

    def go_on(cycles: int) -> None:
        for _ in range(cycles):
            exchange(master, [load])

    go_on(250)
    assert secure(master, [True])
    if led:
        set_modes(master, [Mode.TORQUE])
        go_on(20)
        master.set_loops([Loop(load, 20.0)])
    rested = axis.plant.q
    axis.take_up(GivesLess(at=cell.bus.now(), torque=left * load, echoes=echoes))
    if led:
        go_on(10)  # until a person stops the run
    else:
        with pytest.raises(SafetyStop, match="A1"):
            go_on(500)
    speed = abs(axis.plant.v)
    master.close()
    assert axis.state == "off"
    assert axis.plant.is_braked
    seen_s = brake_s + (0.1 if led else 0.0)
    assert rested - axis.plant.q < speed * seen_s + 0.5 * load * seen_s**2 + 0.02
    assert master.held.holdings[0].brake_in_time
