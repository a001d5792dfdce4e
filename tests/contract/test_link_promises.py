"""What the link promises from its first frame to its last, on drives of another author that enforce nothing.

What drives, loads and other masters do meanwhile: `test_foreign_kinds.py`.
"""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from other_cell import LIMIT, OtherCell

import invid
from invid.errors import DriveError, SafetyStop
from invid.sweep import Mode
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen

NOTHING, LOADED = {"gravity_loaded": False}, {"gravity_loaded": True}
LOAD = {"gravity": 3.0}


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
