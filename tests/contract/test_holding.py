"""Nothing falls: loaded axes are seen to be held before they move, and are taken over without letting go.

Judged on the drives and the plant: 1 N·m pulls A1 (1 kg·m², no brake unless told), which stands on a prop
until its drive holds it first.
"""

import re
from pathlib import Path
from typing import Any

import pytest
from stepping import energise, exchange, secure, set_modes
from test_adapter_promises import config, held, zero

from invid.errors import DriveError, InvidError, SafetyStop
from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import remembered, to_support
from invid_drivers.cia402.states import DriveState
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus
from invid_drivers.simulated.config import FaultConfig

ENERGISED = {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE}
FALLS = 0.02


class Bench:
    """One cell, its commands one after another, and what its loaded drive was in at every change."""

    def __init__(self, folder: Path, drive: dict[str, Any] | None = None, **axis: Any) -> None:
        self.config = config({"axes": {"A1": {"load": {"torque_Nm": 1.0}, "brake": False, **(drive or {})}}})
        first = self.config.axes[0].model_copy(update={"gravity_loaded": True, **axis})
        self.config = self.config.model_copy(update={"axes": [first, self.config.axes[1]]})
        self.journal = folder / "bus.journal"
        self._port: Any = open_virtual_bus(self.config)
        self._wire = self._port.wire
        self.cell = self._wire.cell
        self.drive = self.cell.drives[0]
        self.states: list[DriveState] = []
        enter = self.drive._enter

        def entered(state: DriveState) -> None:
            self.states.append(state)
            enter(state)

        self.drive._enter = entered

    def connect(self) -> Cia402Cell:
        port = self._port or VirtualTimeBus(self.config.bus.channel, wire=self._wire)
        self._port = None
        return Cia402Cell(port, self.config, journal=Journal(self.journal))

    @property
    def place(self) -> float:
        self.cell.plant.advance_to(self.cell.now_ns)
        return float(self.cell.plant.positions[0])

    @property
    def memory(self) -> HoldMemory:
        return HoldMemory.beside(self.journal)


def enabled(bench: Bench) -> Cia402Cell:
    master = bench.connect()
    master.check()
    energise(master, held(master))
    for _ in range(50):
        exchange(master, zero(master))
    return master


def left_held(bench: Bench) -> None:
    """A first run, whose stop test is passed, ends with A1 held by its drive."""
    master = enabled(bench)
    assert secure(master, [True, False])
    master.close()


def settings(bench: Bench) -> dict[tuple[int, int], Any]:
    """All that can be written, but for 0x1003, in which the drive itself notes that its master is gone."""
    rw = (e for e in bench.drive.node.od if e.access == "rw" and e.index != 0x1003)
    return {(e.index, e.sub): e.value for e in rw}


def test_a_drive_is_seen_to_hold_its_load_once_and_remembered_by_its_serial_number(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    assert to_support(bench.config, bench.memory) == ("A1",)
    master = enabled(bench)
    before = bench.place
    assert secure(master, [True, False])
    assert abs(bench.place - before) < 0.001
    assert DriveState.QUICK_STOP_ACTIVE in bench.states
    assert not secure(master, [True, False])
    said = master.close()
    assert any("A1 is energised" in line and "support" in line for line in said)
    seen = bench.memory.of_axis(1)
    assert seen is not None
    assert seen.holds
    assert seen.resumes
    assert to_support(bench.config, bench.memory) == ()


def test_a_soft_loop_that_has_sagged_goes_on_from_where_it_is_after_a_gentle_quick_stop(
    tmp_path: Path,
) -> None:
    """The ramp of the stop is over when the drive is given its present place as target."""
    drive = {"position_loop_Hz": 5.0, "quick_stop_deceleration_rad_per_s2": 5.0}
    bench = Bench(tmp_path, drive)
    master = enabled(bench)
    before = bench.place
    assert secure(master, [True, False])
    assert abs(bench.place - before) < 6 * 1.0 / (2 * 3.1416 * 5.0) ** 2  # a sag for each of five holds
    master.close()


def test_check_leaves_a_held_axis_as_it_is_and_does_not_call_the_cell_ready(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    left_held(bench)
    bench.states.clear()
    entries = settings(bench)
    commands: list[bytes] = []
    receive = bench.cell.receive

    def heard(can_id: int, data: bytes, now_ns: int) -> None:
        if can_id == 0 and data[1] in (0, 1):
            commands.append(data)
        receive(can_id, data, now_ns)

    bench.cell.receive = heard
    master = bench.connect()
    master.check()
    assert [(r.code, "A1" in r.text) for r in master.held.not_ready] == [("axis_energised", True)]
    assert [r.code for r in remembered(bench.config, bench.memory)] == ["axis_energised"]
    master.close()
    assert bench.states == []
    assert commands == []
    assert settings(bench) == entries
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE


def test_the_next_run_takes_a_held_axis_over_without_a_gap_in_its_torque(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    left_held(bench)
    before = bench.place
    bench.states.clear()
    master = enabled(bench)
    assert bench.drive.state is DriveState.OPERATION_ENABLED
    assert secure(master, [True, False])  # what was seen once is seen again
    assert not secure(master, [True, False])
    master.close()
    assert set(bench.states) <= ENERGISED
    bench.cell.plant.advance_to(bench.cell.now_ns)
    assert abs(bench.place - before) < 0.001


def test_a_drive_without_transition_16_is_remembered_and_not_taken_over(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    enter = bench.drive._enter

    def no_way_back(state: DriveState) -> None:
        if bench.drive.state is not DriveState.QUICK_STOP_ACTIVE or state is not DriveState.OPERATION_ENABLED:
            enter(state)

    bench.drive._enter = no_way_back
    master = enabled(bench)
    with pytest.raises(SafetyStop, match="transition 16"):
        secure(master, [True, False])
    master.close()
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    again = bench.connect()
    again.check()
    with pytest.raises(DriveError, match=r"A1 .*cannot be taken over without letting go.*load supported"):
        energise(again, held(again))
    again.close()
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    assert abs(bench.place) < FALLS


@pytest.mark.parametrize(
    "objects",
    [{"lacks": ["0x605A"]}, {"read_only": ["0x605A"]}],
    ids=["missing", "read-only"],
)
@pytest.mark.parametrize("stated", [True, None], ids=["loaded", "unknown"])
def test_an_axis_that_nothing_would_hold_is_refused_before_it_is_enabled(
    tmp_path: Path, objects: dict[str, Any], stated: bool | None
) -> None:
    bench = Bench(tmp_path, {"objects": objects}, gravity_loaded=stated)
    master = bench.connect()
    with pytest.raises(DriveError, match=r"A1 .*0x605A.*brake: drive"):
        master.check()
    master.close()
    assert bench.states == []


def test_an_axis_stated_to_carry_nothing_needs_no_quick_stop_option(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path, {"objects": {"lacks": ["0x605A"]}, "load": {"torque_Nm": 0.0}}, gravity_loaded=False
    )
    master = enabled(bench)
    secure(master, [False, False])
    assert master.close() == []
    assert bench.drive.state not in ENERGISED


def test_a_drive_that_does_not_notice_that_its_master_is_gone_fails_the_stop_test(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"objects": {"lacks": ["0x6007"]}})
    master = enabled(bench)
    with pytest.raises(SafetyStop, match=r"A1.*without its master.*operation enabled"):
        secure(master, [True, False])
    master.close()
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    assert abs(bench.place) < FALLS
    seen = bench.memory.of_axis(1)
    assert seen is not None
    assert seen.holds is False


@pytest.mark.parametrize("boot_s", [0.15, 60.0])
def test_what_held_a_load_and_starts_anew_is_not_said_to_hold_it_and_is_not_enabled_again(
    tmp_path: Path, boot_s: float
) -> None:
    """Its supply fails in the stop test; nothing is heard of it before it has started."""
    bench = Bench(tmp_path)
    node = bench.drive.node
    node._boot_ns = round(1e9 * boot_s)
    master = enabled(bench)
    tick, stood = master.tick, []

    def failing(wish: Any) -> Any:
        stood.append(bench.drive.state is DriveState.QUICK_STOP_ACTIVE)
        if sum(stood) == 500:
            bench.states.clear()
            node.power_on(bench.cell.now_ns)
        return tick(wish)

    master.tick = failing  # type: ignore[method-assign]
    with pytest.raises(InvidError, match="A1"):
        secure(master, [True, False])
    said = " ".join(master.close())
    assert DriveState.OPERATION_ENABLED not in bench.states
    assert master.not_held == ("A1",)
    assert "is held by its drive" not in said
    assert "Support it before anybody goes near" in said


def test_a_load_that_is_cut_off_while_settings_are_restored_is_not_said_to_be_held(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    master = enabled(bench)
    secure(master, [True, False])
    master.stop()
    assert master.held_at_end == ("A1",)
    bench.drive.node.power_on(bench.cell.now_ns)
    said = " ".join(master.close())
    assert master.held_at_end == ()
    assert "is held by its drive" not in said
    assert "Support it before anybody goes near" in said


def test_of_a_load_whose_drive_falls_silent_nothing_is_said_that_nobody_has_seen(tmp_path: Path) -> None:
    """It is switched on and silent from then on, and enabled by what is on its way to it."""
    bench = Bench(tmp_path)
    master = bench.connect()
    master.check()
    get, silent = master._link.get, []

    def heard(timeout: float) -> Any:
        message = get(timeout)
        silent.append(bench.drive.state is DriveState.SWITCHED_ON or any(silent[-1:]))
        return None if message is not None and silent[-1] and message.arbitration_id & 0x7F == 1 else message

    master._link.get = heard  # type: ignore[method-assign]
    with pytest.raises(InvidError, match="A1"):
        energise(master, held(master))
    said = " ".join(master.close())
    assert re.search(r"A1 carries a load, says nothing any more .* may be energised: nothing was seen", said)
    assert "is without torque" not in said


@pytest.mark.parametrize(("delay", "by"), [(0.02, "brake"), (0.4, "drive")])
def test_a_brake_is_measured_and_one_that_is_late_is_not_relied_on(
    tmp_path: Path, delay: float, by: str
) -> None:
    bench = Bench(tmp_path, {"brake": True, "brake_delay_s": delay}, brake="drive")
    master = enabled(bench)
    assert secure(master, [True, False])
    assert master.held.holdings[0].held_by == by
    before = bench.place
    master.close()
    assert (bench.drive.state is DriveState.QUICK_STOP_ACTIVE) == (by == "drive")
    bench.cell.plant.advance_to(bench.cell.now_ns)
    assert abs(bench.place - before) < FALLS
    seen = bench.memory.of_axis(1)
    assert seen is not None
    assert seen.brake_s is not None
    assert (seen.brake_drop > master.held.holdings[0].most_drop) == (by == "drive")
    if by == "drive":  # 1 N·m on 1 kg·m²; it could not be seen before it closed
        assert seen.falls == pytest.approx(1.0, rel=0.3)
        said = master.held.holdings[0].said("axis A1")
        found = re.search(r"falls until that brake has closed: .*, ([\d.]+) at most in 0.3 s", said)
        assert found is not None
        assert float(found[1]) > 0.5 * (0.074 + 0.3) ** 2  # seen after 74 ms
    if by == "brake":
        assert seen.brake_s == pytest.approx(delay, abs=0.02)


def test_an_axis_of_unknown_gravity_that_carries_nothing_may_switch_off_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"load": {"torque_Nm": 0.0}}, gravity_loaded=None)
    master = enabled(bench)
    od = bench.drive.node.od
    assert od.number(0x605A) == 6  # until it is known
    secure(master, [False, False])
    assert master.close() == []
    assert od.number(0x605A) == 2
    assert bench.drive.state not in ENERGISED


def test_a_stop_before_the_load_is_known_leaves_an_axis_of_unknown_gravity_held(tmp_path: Path) -> None:
    bench = Bench(tmp_path, gravity_loaded=None)
    master = enabled(bench)
    master.stop()
    assert master.held_at_end == ("A1",)
    master.close()
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    assert abs(bench.place) < FALLS


def test_a_load_that_the_config_denies_is_held_after_the_stop(tmp_path: Path) -> None:
    bench = Bench(tmp_path, gravity_loaded=False)
    master = enabled(bench)
    assert secure(master, [True, False])
    master.close()
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    assert abs(bench.place) < FALLS


def test_a_loaded_axis_at_which_a_run_ended_waits_for_a_person(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    master = enabled(bench)
    secure(master, [True, False])
    master.stop()
    master.suspect(SafetyStop("axis A1: position left its window", axis="A1"))
    master.close()
    again = bench.connect()
    again.check()
    assert {r.code for r in again.held.not_ready} == {"axis_suspect", "axis_energised"}
    assert not any("A2" in r.text for r in again.held.not_ready)
    with pytest.raises(DriveError, match=r"Find the cause; .*--cleared A1`\. axis A1 .* is energised: "):
        energise(again, held(again))
    again.close()
    cleared = bench.connect()
    cleared.held.clear(["A1"])
    cleared.check()
    energise(cleared, [Mode.HOLD, Mode.HOLD])
    assert bench.drive.state is DriveState.OPERATION_ENABLED
    cleared.close()
    assert abs(bench.place) < FALLS


def wrongly_scaled(tmp_path: Path, **axis: Any) -> Bench:
    """0x6076 says 100 N·m, the motor has 10: 5 N·m of the config are 50 ‰, 0.5 N·m; the load is 1 N·m."""
    return Bench(tmp_path, {"objects": {"values": {"0x6076": 100_000}}}, **axis)


@pytest.mark.parametrize("stated", [{}, {"gravity_loaded": None}, {"inertia": 1.0}])
def test_a_load_beyond_the_torque_limit_ends_the_run_in_time_and_nothing_raises_the_limit(
    tmp_path: Path, stated: dict[str, Any]
) -> None:
    """Whoever stated the scale: 0x6072 is what the config permits in it, on the way in and out."""
    bench = wrongly_scaled(tmp_path, **stated)
    master = bench.connect()
    master.check()
    seen: list[int] = []
    tick = master.tick

    def watched(wish: Any) -> Any:
        seen.append(int(bench.drive.node.od.number(0x6072)))
        return tick(wish)

    master.tick = watched  # type: ignore[method-assign]
    with pytest.raises(SafetyStop, match=r"A1.*all that its limit permits") as caught:
        enabled_and_settled(master)
    assert "raise its torque limit" in str(caught.value)
    assert set(seen) == {50}
    ended = bench.drive.node.od.number(0x6072)
    master.close()
    assert ended == 50
    assert abs(bench.place) < 1.0  # half of its weight is held: it sinks, and the run says so
    # more than the limit: refused from then on
    assert [seen.weight for seen in bench.memory.seen.values() if seen.loaded] == [51]


def enabled_and_settled(master: Cia402Cell) -> None:
    """As the sweep does it: every cycle is watched."""
    energise(master, held(master))
    while master.clock.now() < 10.0:
        exchange(master, zero(master))


def test_a_load_that_was_held_within_the_lowered_limit_gets_no_more_torque_when_a_sign_turns(
    tmp_path: Path,
) -> None:
    bench = Bench(tmp_path)
    master = enabled(bench)  # held for 0.1 s, which shows that its limit is enough
    lowered = bench.drive.node.od.number(0x6072)
    bench.cell.injector.plan(
        FaultConfig(kind="sign_flip", axis="A1", at_s=master.clock.now() + 0.1, signal="encoder")
    )

    def go_on() -> None:
        for _ in range(150):
            exchange(master, zero(master))
            assert bench.drive.node.od.number(0x6072) <= lowered

    with pytest.raises(SafetyStop, match=r"A1: is to stand and gets faster"):
        go_on()
    master.stop()
    assert bench.drive.node.od.number(0x6072) <= lowered
    assert bench.drive.state not in ENERGISED
    bench.cell.plant.advance_to(bench.cell.now_ns)
    assert abs(bench.cell.plant.velocities[0]) < 2.0
    master.close()


def test_no_brake_and_no_drive_is_judged_by_an_axis_that_moved_before_the_test(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"brake": True, "brake_delay_s": 0.02}, brake="drive")
    master = enabled(bench)
    bench.cell.injector.plan(
        FaultConfig(kind="push", axis="A1", at_s=master.clock.now(), torque_Nm=8.0, duration_s=10.0)
    )
    for _ in range(10):
        exchange(master, zero(master))
    with pytest.raises((SafetyStop, DriveError)):  # by its motion, or its drive by its following error
        secure(master, [True, False])
    assert all(seen.brake_drop is None for seen in bench.memory.seen.values())
    master.close()


def test_an_axis_of_unknown_gravity_is_weighed_after_a_stop_that_came_before_that(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"load": {"torque_Nm": 0.0}}, gravity_loaded=None)
    master = enabled(bench)
    master.stop()
    assert master.held_at_end == ()
    assert bench.drive.state not in ENERGISED
    master.close()


def test_the_master_stays_until_an_axis_that_its_drive_holds_stands(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    master = enabled(bench)
    assert secure(master, [True, False])
    set_modes(master, [Mode.TORQUE, Mode.HOLD])
    while master.changing:
        exchange(master, [1.0, 0.0])
    for _ in range(100):
        exchange(master, [4.0, 0.0])  # 3 N·m beyond the load
    bench.cell.plant.advance_to(bench.cell.now_ns)
    assert bench.cell.plant.velocities[0] > 0.3
    master.stop()
    bench.cell.plant.advance_to(bench.cell.now_ns)
    assert abs(bench.cell.plant.velocities[0]) < 0.01
    assert bench.drive.state is DriveState.QUICK_STOP_ACTIVE
    master.close()
