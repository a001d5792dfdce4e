"""What the link promises from its first frame to its last, on drives of another author that enforce nothing.

Judged on the plant: torque within the tightest limit, travel within window and what coasts, loads where they
were, nodes that are somebody else's as they were.
"""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from other_cell import LIMIT, WINDOW, OtherCell

import invid
from invid.errors import DriveError, SafetyStop
from invid.sweep import Mode
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen

NOTHING, LOADED = {"gravity_loaded": False}, {"gravity_loaded": True}
LOAD = {"gravity": 3.0}
TORQUE_ONLY = {"0x6502": 1 << 9}
HELD = 0.02
"""A loaded axis may be so far from where it stood [rad]."""


def most_torque(cell: OtherCell) -> float:
    return max(max(d.axis.commanded, d.axis.by_loop) for d in cell.drives)


@pytest.mark.parametrize(("follows", "slow"), [(True, 2.4), (False, 0.0)])
def test_opposed_wiring_of_an_unstated_load_gets_no_more_than_its_limit_and_is_cut_off_at_once(
    tmp_path: Path, follows: bool, slow: float
) -> None:
    nodes: list[dict[str, Any]] = [{**LOAD, "opposed": True, "follows": follows}, {"enable": slow}]
    cell = OtherCell(tmp_path, nodes, [{}, NOTHING])
    motor = cell.drives[0].axis
    error = cell.measure()
    assert isinstance(error, SafetyStop)
    assert most_torque(cell) <= 1.05 * LIMIT
    assert cell.drives[0].state == "switch on disabled"
    assert motor.powered_travel < WINDOW  # nothing holds it then
    assert motor.powered_speed < 2.0


@pytest.mark.parametrize("stated", [LOADED, {}], ids=["stated", "not stated"])
def test_a_drive_that_cannot_hold_a_load_in_place_is_refused_before_it_is_enabled(
    tmp_path: Path, stated: dict[str, Any]
) -> None:
    hold = {"mode": "master_pd", "gain_Nm_per_rad": 200, "damping_Nms_per_rad": 20}
    cell = OtherCell(tmp_path, [{**LOAD, "values": TORQUE_ONLY}], [{**stated, "hold": hold}])
    error = cell.measure()
    assert isinstance(error, DriveError)
    assert "cyclic synchronous position" in str(error)
    cell.bus.advance(1.0)
    assert cell.drives[0].axis.travel == 0.0


def test_a_drive_that_accepts_a_quick_stop_option_and_coasts_is_caught_before_its_load_has_moved(
    tmp_path: Path,
) -> None:
    cell = OtherCell(tmp_path, [{**LOAD, "stops_by": 0}], [LOADED])
    axis = cell.drives[0].axis

    def supported() -> None:  # a person who was told puts something under it
        assert cell.drives[0].state == "operation enabled"
        axis.gravity = 0.0

    cell.bus.at.append((6.0, supported))
    error = cell.measure()
    cell.bus.advance(0.5)
    assert isinstance(error, SafetyStop)
    assert "let it fall" in str(error)
    assert axis.travel < HELD


def test_a_drive_that_lets_go_when_its_master_is_silent_is_caught_in_the_silence(tmp_path: Path) -> None:
    cell = OtherCell(tmp_path, [LOAD], [LOADED])
    drive = cell.drives[0]
    drive.connection_lost = lambda: drive.enter("switch on disabled")  # type: ignore[method-assign]
    cell.bus.at.append((8.0, lambda: setattr(drive.axis, "gravity", 0.0)))
    error = cell.measure()
    assert isinstance(error, SafetyStop)
    assert drive.axis.travel < HELD


@pytest.mark.parametrize("frame", [(0x080, b""), (0x601, bytes(8))], ids=["SYNC", "SDO"])
def test_check_sends_nothing_to_a_held_axis_while_another_master_speaks(
    tmp_path: Path, frame: tuple[int, bytes]
) -> None:
    cell = OtherCell(tmp_path, [{**LOAD, "power_in_operational": True}], [LOADED])
    assert cell.measure() is None
    drive = cell.drives[0]
    assert drive.state == "quick stop active"
    drive.axis.mark()
    cell.bus.sent.clear()
    cell.bus.at.append((cell.bus.time + 0.5, lambda: cell.bus.arrive(*frame)))
    assert "nothing was sent" in cell.check()
    cell.bus.advance(1.0)
    assert cell.bus.sent == []
    assert drive.state == "quick stop active"
    assert drive.axis.travel < HELD


def test_the_journal_of_a_killed_run_gives_no_right_to_a_node_that_another_master_drives_now(
    tmp_path: Path,
) -> None:
    cell = OtherCell(tmp_path, [{}], [NOTHING])
    killed = cell.connect()
    killed.check()
    killed.energise([Mode.HOLD])
    assert killed.journal.entries
    drive = cell.drives[0]
    cell.bus.advance(1.0)  # nobody restores, and the drive has stopped by itself
    drive.enter("operation enabled")  # by its new master
    cell.bus.sent.clear()
    for k in range(20):
        cell.bus.at.append((cell.bus.time + 0.1 * k, lambda: cell.bus.arrive(0x080, b"")))
    assert "nothing was sent" in cell.check()
    assert cell.bus.sent == []
    assert drive.state == "operation enabled"


def test_no_disk_is_waited_for_while_an_axis_is_energised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = OtherCell(tmp_path, [LOAD], [LOADED])
    flushed: list[tuple[bool, bool]] = []
    fsync = os.fsync

    def slow(file: int) -> None:
        energised = any(d.axis.energised for d in cell.drives)
        flushed.append((threading.current_thread() is threading.main_thread(), energised))
        fsync(file)

    monkeypatch.setattr(os, "fsync", slow)
    # On a bus in real time another process writes the recording; here only what the link writes is judged.
    monkeypatch.setattr("invid.recording.spool.sync_folder", lambda folder: None)
    monkeypatch.setattr("invid.recording.writer.put_in_place", lambda rows, target, outcome: None)
    assert cell.measure() is None
    assert HoldMemory.beside(tmp_path / "bus.journal").of_node(1) == replace(
        Seen(1), loaded=True, holds=True, resumes=True, left_held=True, weight=300
    )
    assert any(energised for _, energised in flushed)
    assert not any(main for main, _ in flushed)


def test_a_drive_that_answers_no_request_under_power_is_named_and_its_axis_stays_watched(
    tmp_path: Path,
) -> None:
    cell = OtherCell(tmp_path, [LOAD, {}], [{}, {}])
    drive = cell.drives[1]

    def deaf() -> None:
        drive.port.subscriptions.pop(0x602)

    cell.bus.at.append((2.0, deaf))  # enabled, not weighed yet
    error = cell.measure()
    assert isinstance(error, DriveError)
    assert "A2" in str(error)
    assert "does not answer" in str(error)
    assert cell.drives[0].axis.travel < HELD


@pytest.mark.parametrize("damage", ["", "[]"])
def test_with_a_damaged_memory_no_axis_is_enabled_until_a_person_has_cleared_it(
    tmp_path: Path, damage: str
) -> None:
    cell = OtherCell(tmp_path, [{}], [NOTHING])
    (tmp_path / "bus.holds.json").write_text(damage, encoding="utf-8")
    error = cell.measure()
    assert isinstance(error, DriveError)
    assert "--cleared A1" in str(error)
    assert not any(cob == 0x201 for _, cob, _ in cell.bus.sent)
    cleared = cell.connect()
    cleared.clear(["A1"])
    cleared.close()
    assert cell.measure() is None


@pytest.mark.parametrize(("shows", "refused"), [(0.4, True), (0.85, False), (2.0, True)])
def test_a_drive_that_shows_another_torque_than_it_was_asked_for_is_refused_in_the_first_trial(
    tmp_path: Path, shows: float, refused: bool
) -> None:
    cell = OtherCell(tmp_path, [{"shows": shows}], [NOTHING])
    error = cell.measure()
    assert (error is not None) is refused
    if refused:
        assert isinstance(error, SafetyStop)
        assert f"is {shows:g} times the commanded one" in str(error)
        assert "0x6076" in str(error)
        assert "0x6075" in str(error)
        assert cell.drives[0].axis.commanded <= 0.1 * LIMIT


@pytest.mark.parametrize(("rated", "doubted"), [(4_000, True), (9_500, False)])
def test_a_model_that_contradicts_the_stated_inertia_says_so_first_and_names_both_readings(
    tmp_path: Path, rated: int, doubted: bool
) -> None:
    """A rated torque that is wrong for 0x6071 and 0x6077 alike shows in no trial below a factor of three."""
    cell = OtherCell(tmp_path, [{"values": {"0x6076": rated}}], [{**NOTHING, "inertia_kgm2": 1.0}])
    assert cell.measure() is None
    recording = invid.read_recording(tmp_path / "rec.h5")
    model = invid.identify(recording)
    assert model.chains.masses[0].sum() == pytest.approx(rated / 10_000, rel=0.02)
    assert model.fit["trustworthy"] is not doubted
    said = model.warnings[0] if model.warnings else ""
    assert ("0x6076" in said and "0x6075" in said and "another tool" in said) is doubted
    if doubted:
        diagnosis = invid.diagnose(recording)
        assert "0x6075" in diagnosis.warnings[0]
        assert not diagnosis.model.fit["trustworthy"]
        assert "0.4 times the one in the config" in diagnosis.headline
