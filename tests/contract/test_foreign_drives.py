"""Whatever stops, fails or lies: an axis stands, or the product says that it does not. On drives of another
style.

Judged on the true motion of the plant (8 N·m on 1 kg·m², 16 bits, 2 ms) in virtual time, and on what was
said.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from foreign_wire import LIMIT, LOAD, ForeignCell, ForeignDrive, Habits, Run

from invid.errors import DriveError, SafetyStop

STATED, NOTHING, UNKNOWN = {"gravity_loaded": True}, {"gravity_loaded": False}, {}
BRAKE = {"brake": "drive"}
HELD = 0.02
"""So far may a loaded axis move in one event [rad]."""
SHAKEN_S = 18.0
"""By then a loaded axis is shaken."""


def loaded(
    folder: Path, *, brake: float | None = None, stated: dict[str, Any] = STATED, **habits: Any
) -> ForeignCell:
    axis = stated if brake is None else {**stated, **BRAKE}
    return ForeignCell(folder, [Habits(load=LOAD, brake=brake, **habits)], [axis])


def run(cell: ForeignCell, what: Callable[[ForeignDrive], None], seconds: float = SHAKEN_S) -> Run:
    """One measurement in which something happens to the first drive."""
    cell.wire.at(seconds, lambda: what(cell.drives[0]))
    ended = cell.measure()
    cell.wire.advance(cell.wire.now + 1.0)
    return ended


def supported(cell: ForeignCell, after: float = 2.0) -> None:
    """A person puts something under a load that was let go and caught, some seconds after its drive was
    enabled."""
    drive = cell.drives[0]
    seen: list[float] = []

    def look() -> None:
        if drive.limp:
            seen.append(cell.wire.now)
        if seen and cell.wire.now > seen[0] + after and drive.powered and not drive.limp:
            drive.habits.load = 0.0

    cell.wire.each = look


def test_an_ordinary_loaded_axis_is_tried_measured_and_left_held_in_its_place(tmp_path: Path) -> None:
    cell = loaded(tmp_path)
    ended = cell.measure()
    assert ended.error is None
    assert cell.drives[0].state == "stopping"
    before = cell.wire.now
    cell.wire.advance(before + 2.0)
    assert cell.fallen(since=before) < 0.001
    assert cell.fallen() < HELD


# --- held is seen ---------------------------------------------------------------------------------
def test_a_quick_stop_that_gives_up_its_torque_in_torque_mode_is_caught_at_rest(tmp_path: Path) -> None:
    cell = loaded(tmp_path, stops_from_torque=False)
    supported(cell)
    ended = cell.measure()
    assert isinstance(ended.error, SafetyStop)
    assert "stop test" in ended.words
    assert "let it fall" in ended.words
    assert cell.fallen() < HELD


def test_a_quick_stop_option_that_lies_is_caught_at_rest_and_held_until_supported(tmp_path: Path) -> None:
    cell = loaded(tmp_path, lies=True)
    supported(cell)
    ended = cell.measure()
    assert isinstance(ended.error, SafetyStop)
    assert cell.fallen() < HELD


def test_a_brake_that_fails_at_the_end_of_a_later_run_is_seen_and_its_drive_holds_the_axis(
    tmp_path: Path,
) -> None:
    cell = loaded(tmp_path, brake=0.03)
    assert cell.measure().error is None
    drive = cell.drives[0]
    drive.habits.brake_good = drive.closings + 1  # it is tried at rest, and good; then it is worn out
    ended = cell.measure()
    let_go = max(now for now, _, _, state in drive.log if state not in ("enabled", "stopping"))
    assert isinstance(ended.error, DriveError)
    assert "its brake was seen not to hold it" in ended.words
    assert "held by its drive" in ended.words
    cell.wire.advance(cell.wire.now + 2.0)
    assert drive.state == "stopping"
    assert cell.fallen(since=let_go - 0.06) < HELD


def test_a_brake_that_fails_when_it_is_tried_leaves_the_axis_to_its_drive(tmp_path: Path) -> None:
    cell = loaded(tmp_path, brake=0.03)
    assert cell.measure().error is None
    cell.drives[0].habits.brake_good = cell.drives[0].closings
    ended = cell.measure()
    assert ended.error is None
    assert "its brake was seen to close too late" in ended.words
    cell.wire.advance(cell.wire.now + 2.0)
    assert cell.drives[0].state == "stopping"
    assert cell.fallen(since=cell.wire.now - 2.0) < 0.001


def test_a_load_that_is_not_seen_to_stand_is_said_at_once_not_after_the_way_out(tmp_path: Path) -> None:
    cell = loaded(tmp_path)
    said: list[tuple[float, str]] = []
    cell.wire.at(SHAKEN_S, lambda: setattr(cell.drives[0].habits, "gives", 5.0))
    cell.measure(on_phase=lambda phase: said.append((cell.wire.now, phase)))
    heard = [now for now, phase in said if phase.startswith("support the load of A1")]
    assert SHAKEN_S < heard[0] < SHAKEN_S + 0.1
    quiet = loaded(tmp_path / "held")
    quiet.measure(on_phase=lambda phase: said.append((-1.0, phase)))
    assert {phase for now, phase in said if now < 0} >= {"stopping"}
    assert not any(phase.startswith("support") for now, phase in said if now < 0)


# --- nothing falls unseen -------------------------------------------------------------------------
@pytest.mark.parametrize("brake", [0.1, None])
def test_a_drive_that_gives_less_than_its_load_is_told_by_its_torque(
    tmp_path: Path, brake: float | None
) -> None:
    """What is left of 3 rad/s² until the brake has closed; without one nothing holds it, and that is said."""
    cell = loaded(tmp_path, brake=brake)
    ended = run(cell, lambda drive: setattr(drive.habits, "gives", 5.0))
    assert isinstance(ended.error, SafetyStop)
    assert ended.error.code == "no_torque"
    if brake is None:
        assert "A1 carries a load and is not held" in ended.words
        assert "held by its drive" not in ended.words
        reacted = SHAKEN_S + 0.1
        assert cell.fallen(since=SHAKEN_S) - cell.fallen(since=reacted) < 0.08
    else:
        by_brake = 0.5 * LOAD * brake**2
        assert cell.fallen(since=SHAKEN_S) < by_brake + HELD


@pytest.mark.parametrize("load", [LOAD, 0.0])
def test_motor_and_encoder_opposed_are_cut_off_before_the_axis_is_fast(tmp_path: Path, load: float) -> None:
    cell = ForeignCell(tmp_path, [Habits(load=load, opposed=True)], [UNKNOWN])
    drive = cell.drives[0]
    fastest = 0.0

    def look() -> None:
        nonlocal fastest
        fastest = max(fastest, abs(drive.v)) if drive.powered else fastest

    cell.wire.each = look
    ended = cell.measure()
    assert isinstance(ended.error, SafetyStop)
    assert drive.state == "off"
    assert drive.most_torque <= LIMIT
    assert fastest < 2.0  # 20 N·m on 1 kg·m² for less than 0.1 s
    assert "held by its drive" not in ended.words


@pytest.mark.parametrize("away", [0.0, -0.05])
def test_a_dead_encoder_is_left_to_the_brake(tmp_path: Path, away: float) -> None:
    cell = loaded(tmp_path, brake=0.03)
    instant = 17.6  # elsewhere see docs/reference/safety-tests.md
    ended = run(cell, lambda drive: setattr(drive.habits, "frozen", drive.seen + away), instant)
    assert isinstance(ended.error, SafetyStop)
    assert cell.drives[0].state == "off"
    shaken = 0.06  # until it is known that the encoder should move, its axis goes on with what is played
    assert cell.fallen(since=instant) < shaken + HELD


def test_an_encoder_that_dies_at_rest_is_told_by_the_torque_that_is_missing(tmp_path: Path) -> None:
    """Its drive sees no error, gives no torque, and the load falls while every count stands still."""
    cell = loaded(tmp_path, brake=0.03)
    ended = run(cell, lambda drive: setattr(drive.habits, "frozen", drive.seen), 6.0)
    assert isinstance(ended.error, SafetyStop)
    assert ended.error.code == "halted"
    assert cell.drives[0].state == "off"
    assert cell.fallen() < 0.04  # until the torque is missed, and the brake


def test_torque_that_turns_unseen_under_a_load_is_cut_off_and_left_to_the_brake(tmp_path: Path) -> None:
    cell = loaded(tmp_path, brake=0.03)
    ended = run(cell, lambda drive: setattr(drive.habits, "turned", True))
    assert isinstance(ended.error, SafetyStop)
    assert cell.drives[0].state == "off"
    assert cell.fallen(since=SHAKEN_S) < 0.25  # 16 rad/s² to the permitted speed: a stated bound


# --- hand-overs carry the torque ------------------------------------------------------------------
def test_a_mode_that_is_shown_before_it_acts_lets_nothing_sink(tmp_path: Path) -> None:
    cell = loaded(tmp_path, shown_early=0.1)
    ended = cell.measure()
    assert ended.error is None, ended.words
    assert cell.fallen() < HELD + 0.01  # from end to end, every hold sags


@pytest.mark.parametrize(("opens", "stated"), [(0.4, STATED), (1.2, UNKNOWN)])
def test_a_brake_that_opens_late_is_waited_for_before_the_load_is_weighed(
    tmp_path: Path, opens: float, stated: dict[str, Any]
) -> None:
    cell = loaded(tmp_path, brake=0.03, brake_opens=opens, stated=stated)
    ended = cell.measure()
    assert ended.error is None, ended.words
    assert cell.fallen() < HELD + 0.01


# --- stops ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("seconds", "brake"),
    [
        (4.3, 0.03),
        (5.2, None),
        (7.0, 0.03),
        (9.5, None),
        (11.0, 0.03),
        (13.0, None),
        (SHAKEN_S, None),
        (25.0, 0.03),
    ],
)
def test_a_stop_in_any_phase_leaves_the_axis_standing(
    tmp_path: Path, brake: float | None, seconds: float
) -> None:
    cell = loaded(tmp_path, brake=brake)
    stop = threading.Event()
    cell.wire.at(seconds, stop.set)
    cell.measure(stop)
    cell.wire.advance(cell.wire.now + 1.0)
    assert cell.fallen(since=seconds) < HELD


# --- what physics does not allow is refused, what is healthy runs -------------------------------------
@pytest.mark.parametrize("at", [0x60E000, pytest.param(0x60E100, marks=pytest.mark.campaign)])
def test_a_limit_of_one_direction_is_a_limit_and_a_load_beyond_it_is_refused_the_next_time(
    tmp_path: Path, at: int
) -> None:
    free = ForeignCell(tmp_path / "free", [Habits(values={at: 500})], [NOTHING])
    assert free.measure().error is None
    assert free.drives[0].most_asked <= 5.0
    cell = loaded(tmp_path / "loaded", values={at: 500})
    ended = cell.measure()
    assert isinstance(ended.error, SafetyStop)
    assert "A1 carries a load and is not held" in ended.words
    cell.drives[0].x = cell.drives[0].v = 0.0  # a person has put it back
    cell.drives[0].enter("off")
    cell.drives[0].propped = True
    asked_before = len(cell.wire.sent)
    cleared = cell.connect()
    cleared.clear(["A1"])
    cleared.close()
    again = cell.measure()
    assert isinstance(again.error, DriveError)
    assert "its load" in again.words
    assert cell.drives[0].state == "off"
    assert all(cob != 0x201 for _, cob, _ in cell.wire.sent[asked_before:])


def healthy() -> dict[str, tuple[Habits, dict[str, Any]]]:
    braked = {**STATED, **BRAKE}
    return {
        "SDO in 6 ms": (Habits(sdo=0.006), NOTHING),
        "SDO in 6 ms, loaded": (Habits(load=LOAD, sdo=0.006), STATED),
        "a brake of 0.1 s under twice the load": (Habits(load=2 * LOAD, mass=2.0, brake=0.1), braked),
        "modes without power only": (Habits(modes_at_rest=True), NOTHING),
        "modes without power only, braked": (Habits(load=LOAD, brake=0.03, modes_at_rest=True), braked),
        "no mode for 4 s": (Habits(blank=4.0), NOTHING),
        "no mode for 4 s, loaded": (Habits(load=LOAD, blank=4.0), STATED),
        "event PDOs": (Habits(event=0.01), NOTHING),
        "event PDOs, loaded": (Habits(load=LOAD, event=0.01), STATED),
    }


@pytest.mark.campaign
@pytest.mark.parametrize("what", list(healthy()))
def test_a_healthy_cell_is_measured_whatever_its_drive_is_used_to(tmp_path: Path, what: str) -> None:
    habits, axis = healthy()[what]
    cell = ForeignCell(tmp_path, [habits], [{**axis, "inertia_kgm2": habits.mass}])
    ended = cell.measure()
    assert ended.error is None, ended.words
    assert "computer was late" not in ended.words


def test_a_drive_that_takes_modes_without_power_only_is_refused_at_rest_under_a_load_without_brake(
    tmp_path: Path,
) -> None:
    cell = loaded(tmp_path, modes_at_rest=True)
    ended = cell.measure()
    assert isinstance(ended.error, DriveError)
    assert "without power only" in ended.words
    assert cell.fallen() < HELD


@pytest.mark.parametrize("late", ["drive", "adapter", "adapter, for good"])
def test_who_was_late_is_named_and_it_was_not_the_computer(tmp_path: Path, late: str) -> None:
    cell = ForeignCell(tmp_path, [Habits(), Habits()], [NOTHING, NOTHING])
    if late == "adapter, for good":
        cell.wire.late = lambda now: 0.004
    elif late == "adapter":
        cell.wire.late = lambda now: 0.0045 if now > 8.0 else 0.0
    else:
        cell.wire.at(8.0, lambda: setattr(cell.drives[0].habits, "pdo", 0.0045))
    words = cell.measure().words
    expected = {"drive": "the drive takes longer", "adapter": "the adapter or its driver takes longer"}
    assert expected.get(late, "answers to SYNC without power") in words
    assert "the computer was late" not in words
