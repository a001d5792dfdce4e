"""One loop, one table: what every axis is sent in every state, and where it goes from there.

A drive of a few lines that obeys within a cycle, and a mass that falls where nothing holds it; no bus.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_adapter_promises import config

from invid.errors import DriveError, SafetyStop
from invid.sweep.axis_estimator import AxisLimits, Fall, Kind
from invid.sweep.bounds import Bounds
from invid.sweep.ports import Loop, Sample, Want, Wish
from invid_drivers.cia402.axis import ModeSet
from invid_drivers.cia402.axis_state import RULES, SUPPORT_S, AxisState, Command, Fact
from invid_drivers.cia402.standing.hold_memory import Seen
from invid_drivers.cia402.standing.holding import AxisHolding
from invid_drivers.cia402.states import DriveState, OperationMode
from invid_drivers.cia402.supervised_axis import READY_SPARE_S, SupervisedAxis, Trouble
from invid_drivers.cia402.supervisor import Supervisor

S, F, W = AxisState, Fact, Want
CYCLE, G, WEIGHT = 0.002, 8.0, 8.0
OFF, READY, ON, ENABLED, STOPPED, FAULT, REACTS = 0x50, 0x31, 0x33, 0x37, 0x17, 0x18, 0x1F


class Drive:
    """One drive, its brake and its mass."""

    def __init__(self, load: bool, brake_s: float | None) -> None:
        self.status, self.position, self.speed = OFF, 0.0, 0.0
        self.g = G if load else 0.0
        self.brake_s, self.closes = brake_s, 0.0
        self.lets_go = self.holds_not = self.obeys_not = self.inhibited = False
        self.limp, self.follows, self.asked = False, 0.0, 0.0
        """Gives no torque where it is enabled; follows its master's torque, with this sign."""
        self.ready_after = 1
        """Times that it is told to be ready to switch on."""
        self.propped, self.supported = True, False
        """Until it is enabled; for good."""
        self.heard: list[int] = []

    @property
    def holds(self) -> bool:
        can = self.status == STOPPED or (self.status == ENABLED and not self.limp)
        return can and not self.holds_not

    def obey(self, word: int, now: float) -> None:
        self.heard.append(word)
        before = self.status
        if self.obeys_not or self.status == FAULT:
            return
        if not word & 2 or self.inhibited:
            self.status = OFF
        elif not word & 4:
            stopped = OFF if self.lets_go else STOPPED
            self.status = stopped if self.status in (ENABLED, STOPPED) else OFF
        elif word == 6:
            self.status = READY if self.heard[-self.ready_after :] == [6] * self.ready_after else self.status
        elif word == 7 and self.status in (READY, ENABLED):
            self.status = ON
        elif word == 15 and self.status in (ON, ENABLED, STOPPED):
            self.status = ENABLED
            self.propped = False
        if before in (ENABLED, STOPPED) and self.status not in (ENABLED, STOPPED):
            self.closes = now + (self.brake_s if self.brake_s is not None else math.inf)

    def step(self, now: float) -> None:
        braked = self.brake_s is not None and self.status not in (ENABLED, STOPPED) and now >= self.closes
        if self.propped or self.supported or braked:
            self.speed = 0.0
        elif self.follows and self.status == ENABLED:
            self.speed += (self.follows * self.asked - self.g) * CYCLE
        elif self.holds:
            self.speed -= math.copysign(min(abs(self.speed), 100.0 * CYCLE), self.speed)
        else:
            self.speed -= self.g * CYCLE
        self.position += self.speed * CYCLE

    @property
    def torque(self) -> float:
        return WEIGHT * (self.holds and not (self.propped or self.supported) and self.g > 0)


class Rig:
    """Cycle, link and clock of a supervisor, and the drives behind them."""

    def __init__(self, loads: Sequence[bool] = (True,), *, brake_s: float | None = None, **seen: Any) -> None:
        count = len(loads)
        self.drives = [Drive(load, brake_s) for load in loads]
        self.paused, self.asking, self.asked = False, set[int](), [0.0] * count
        self.control, self.waits_for_power_off = [0] * count, [False] * count
        self.operation: list[OperationMode | None] = [OperationMode.CYCLIC_POSITION] * count
        self.silent, self.deaf, self.told = [False] * count, False, list[tuple[int, int]]()
        self.changes_s, self.pending = 0.0, dict[int, tuple[OperationMode, float]]()
        self.time, self.torques = 1.0, list[Sequence[float]]()
        self.sample = Sample(0, 1.0, [0.0] * count, [0.0] * count, [OFF] * count, [True] * count)
        self.clock, self.heartbeat_s, self.beating = self, 0.05, True
        peers = [SimpleNamespace(booted=False, name="", own_errors=lambda since: []) for _ in loads]
        self.peers = dict(enumerate(peers, start=1))
        limits = [AxisLimits(f"A{k + 1}", 20.0, 0.5, 5.0, 1e-4, 50.0, "rad", "N·m") for k in range(count)]
        bounds = Bounds(limits, cycle_s=CYCLE, missed_tpdos=1000, overrun_cycles=1000)
        first = config().axes[0]
        self.axes = []
        for k, load in enumerate(loads):
            brake = "drive" if brake_s is not None else "none"
            own = {"name": f"A{k + 1}", "node_id": k + 1, "gravity_loaded": load, "brake": brake}
            own["limits"] = first.limits.model_copy(update={"position": 0.5})
            own["inertia"] = 1.0
            known = Seen(k + 1, **seen)
            holding = AxisHolding(
                first.model_copy(update=own), "", known, DriveState.SWITCH_ON_DISABLED, 6, True
            )
            torque = OperationMode.CYCLIC_TORQUE
            self.axes.append(SupervisedAxis(k, holding, bounds.estimators[k], torque, CYCLE, 1.0))
        cycle: Any = self
        self.supervisor = Supervisor(cycle, cycle, bounds, self.axes)

    # --- what a supervisor asks of cycle, link and clock ---
    def now(self) -> float:
        return self.time

    def sleep_until(self, instant: float) -> None:
        self.time = max(self.time, instant)

    def exchange(self, torque: Sequence[float]) -> Sample:
        self.torques.append(torque)
        for drive, asked in zip(self.drives, torque, strict=True):
            drive.asked = asked
        return self._pass([None if self.deaf else word for word in self.control])

    def silent_cycle(self) -> Sample:
        return self._pass([None] * len(self.drives))

    def _pass(self, words: Sequence[int | None]) -> Sample:
        self.time += CYCLE
        for k, (operation, due) in list(self.pending.items()):
            if self.time >= due:
                self.operation[k] = operation
                del self.pending[k]
        sample = self.sample
        sample.slot, sample.time, sample.events = sample.slot + 1, self.time, []
        for k, (drive, word) in enumerate(zip(self.drives, words, strict=True)):
            sample.fresh[k] = not self.silent[k]
            if not self.silent[k]:
                sample.status[k], sample.position[k] = drive.status, drive.position
                sample.torque[k] = drive.torque
            if word is not None:
                drive.obey(word, self.time)
            drive.step(self.time)
        return sample

    def change(self, axis: int, operation: OperationMode, *, taken: bool = False) -> None:
        if self.changes_s and (not taken or math.isinf(self.changes_s)):
            self.pending[axis] = (operation, self.time + self.changes_s)
        else:
            self.operation[axis] = operation

    def change_of(self, axis: int) -> Any:
        change = self.pending.get(axis)
        return None if change is None else SimpleNamespace(operation=change[0], without_power=False)

    def drop_change(self, axis: int) -> None:
        self.pending.pop(axis, None)

    def restart_slots(self) -> None: ...

    def set_object(self, axis: int, what: Any, value: int) -> None:
        self.told.append((axis, value))

    def is_in(self, axis: int, operation: OperationMode) -> bool:
        return self.operation[axis] is operation and axis not in self.pending

    def is_free_for_sdo(self, axis: int) -> bool:
        return True

    def has_taken(self, axis: int) -> bool:
        return axis not in self.pending

    def nmt(self, command: int, node: int) -> None:
        self.told.append((node, command))

    # --- what a test does ---
    def run(self, seconds: float, *wants: Want) -> None:
        for _ in range(round(seconds / CYCLE)):
            self.supervisor.tick(Wish(wants or [W.STAY] * len(self.axes)))

    def bring(self, state: AxisState) -> None:
        """Every axis into a state, by wishes alone."""
        ways = {
            S.HELD: (W.HOLD,), S.LED: (W.HOLD, W.LEAD), S.STANDS: (W.HOLD, W.PARK),
            S.BRAKED: (W.HOLD, W.BRAKE),
        }  # fmt: skip
        count = len(self.axes)
        self.run(0.4)
        for want in ways.get(state, ()):
            self.run(0.6, *[want] * count)
        assert [a.state for a in self.axes] == [state] * count

    def leave(self, seconds: float) -> None:
        self.supervisor.is_leaving = True
        self.run(seconds, *[W.END] * len(self.axes))

    @property
    def states(self) -> list[AxisState]:
        return [a.state for a in self.axes]


def test_an_axis_is_enabled_step_by_step_and_held_and_only_then_led() -> None:
    rig = Rig()
    rig.run(0.1, W.LEAD)
    assert rig.states == [S.OFF]
    assert set(rig.drives[0].heard) == {0}
    rig.bring(S.LED)
    heard = rig.drives[0].heard
    assert [w for w, before in zip(heard[1:], heard, strict=False) if w != before] == [6, 7, 15]
    assert rig.operation == [OperationMode.CYCLIC_TORQUE]
    rig.run(0.6, W.HOLD)
    assert rig.states == [S.HELD]
    assert [s for _, s in rig.axes[0].story][-2:] == [S.STOPPING, S.HELD]
    assert rig.operation == [OperationMode.CYCLIC_POSITION]


GRANTED = {
    (S.OFF, W.HOLD): S.ENABLING, (S.STANDS, W.HOLD): S.ENABLING, (S.BRAKED, W.HOLD): S.ENABLING,
    (S.HELD, W.LEAD): S.LED, (S.LED, W.HOLD): S.STOPPING, (S.HELD, W.PARK): S.PARKING,
    (S.LED, W.PARK): S.PARKING,
    (S.HELD, W.BRAKE): S.BRAKING, (S.LED, W.END): S.STOPPING, (S.HELD, W.END): S.BRAKING,
    (S.CAUGHT, W.END): S.PARKING,
}  # fmt: skip


@pytest.mark.parametrize("state", [s for s in S if s not in (S.ENABLING, S.SWITCHING)])
@pytest.mark.parametrize("want", list(W))
def test_no_wish_lets_a_load_go_and_each_is_granted_in_its_states_only(state: AxisState, want: Want) -> None:
    rig = Rig(brake_s=0.03)
    axis = rig.axes[0]
    axis.status, axis.fresh = (ENABLED if RULES[state].command is Command.ENABLE else OFF), True
    axis.state = state
    rig.supervisor.grant(axis, want)
    assert axis.state is GRANTED.get((state, want), state)


@pytest.mark.parametrize(
    ("state", "status", "after"),
    [
        (S.LED, ENABLED, S.PARKING), (S.HELD, ENABLED, S.PARKING), (S.ENABLING, ENABLED, S.PARKING),
        (S.SWITCHING, ENABLED, S.PARKING), (S.ENABLING, READY, S.LETTING_GO),
        (S.SWITCHING, OFF, S.LETTING_GO),
        (S.STANDS, STOPPED, S.LETTING_GO), (S.OFF, OFF, S.OFF), (S.BRAKED, OFF, S.BRAKED),
    ],
)  # fmt: skip
def test_what_carries_nothing_ends_by_a_quick_stop_or_off(
    state: AxisState, status: int, after: AxisState
) -> None:
    rig = Rig([False])
    axis = rig.axes[0]
    axis.state, axis.status, axis.fresh = state, status, True
    rig.supervisor.grant(axis, W.END)
    assert axis.state is after


@pytest.mark.parametrize("state", [S.HELD, S.LED])
@pytest.mark.parametrize(("status", "back_after"), [(OFF, 0.0), (OFF, 0.3), (FAULT, 0.0)])
def test_what_this_master_did_not_switch_off_it_does_not_enable_again(
    state: AxisState, status: int, back_after: float
) -> None:
    rig = Rig()
    rig.bring(state)
    drive = rig.drives[0]
    drive.status, drive.inhibited, drive.propped = status, back_after > 0, True
    drive.heard.clear()
    with pytest.raises(DriveError, match=r"A1.*left operation enabled"):
        rig.run(0.1)
    rig.leave(max(back_after, 0.01))
    drive.inhibited = False
    rig.leave(3.0)
    assert set(drive.heard[2:]) == {0}
    assert rig.states == [S.FAULT]


@pytest.mark.parametrize("is_mute", [False, True])
@pytest.mark.parametrize("ready_after", [1, 40])
@pytest.mark.parametrize("opened_s", [0.0, 0.1])
def test_what_goes_off_in_a_quick_stop_is_caught_where_its_drive_is_soon_ready_and_else_was_cut_off(
    opened_s: float, ready_after: int, is_mute: bool
) -> None:
    """A drive whose enable input is open does not go to ready to switch on, which takes no power."""
    rig = Rig()
    drive = rig.drives[0]
    drive.ready_after = ready_after
    rig.bring(S.STANDS)
    rig.supervisor.is_leaving = True
    if is_mute:
        rig.supervisor.mute()
    drive.status, drive.inhibited, drive.propped = OFF, opened_s > 0, ready_after > 1
    drive.heard.clear()
    rig.leave(opened_s + (opened_s > 0) * READY_SPARE_S / 2 if ready_after == 1 else 1.3 * opened_s)
    drive.inhibited = False
    rig.leave(1.0)
    assert (15 in drive.heard) is (opened_s == 0.0)
    assert rig.states == [S.FAULT if opened_s else S.CAUGHT]


def test_an_axis_that_falls_before_its_drive_shows_a_mode_is_stopped_and_not_enabled_in_it_again() -> None:
    rig = Rig()
    drive = rig.drives[0]
    drive.limp, rig.operation, rig.changes_s = True, [None], math.inf
    rig.axes[0].takes_mode = ModeSet.TAKEN
    rig.run(0.1)
    with pytest.raises(DriveError, match=r"A1 .*without its mode \(0x6060\) after 0\.\d+ s.*0x6502"):
        rig.run(1.0, W.HOLD)
    drive.heard.clear()
    rig.leave(1.0)
    assert set(drive.heard) == {2}
    assert rig.states == [S.STANDS]
    assert drive.position > -0.02


@pytest.mark.parametrize("is_wrong", [False, True])
def test_an_axis_whose_torque_has_turned_is_slowed_by_its_opposite_and_cut_off_where_that_is_wrong(
    is_wrong: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig([False])
    rig.bring(S.LED)
    drive, bounds = rig.drives[0], rig.supervisor.bounds
    drive.follows, drive.speed = -1.0, -1.0
    rig.run(0.02)

    def disobeys(sample: Sample, asked: Sequence[float]) -> None:
        bounds.observe(sample)
        bounds.falls = {0: Fall(Kind.DRIVEN, math.nan, 0.0, at_limit=False)}
        raise SafetyStop("axis A1: goes the opposite way", axis="A1")

    monkeypatch.setattr(bounds, "check", disobeys)
    with pytest.raises(SafetyStop):
        rig.run(CYCLE)
    assert rig.states == [S.SLOWING]
    if is_wrong:
        drive.g = 60.0
    rig.leave(0.15)
    assert rig.states == [S.LETTING_GO if is_wrong else S.SLOWING]
    assert is_wrong or abs(drive.speed) < 0.05
    if is_wrong:
        (_, began), (_, ended) = [x[::-1] for x in rig.axes[0].story[-2:]]
        assert ended - began < 0.02
    rig.leave(1.0)
    assert rig.states == [S.FAULT]
    assert max(abs(t[0]) for t in rig.torques) <= 20.0


@pytest.mark.parametrize("ends", [True, False])
def test_a_fault_is_the_end_where_its_drive_reacts_no_more_and_else_it_may_be_on(ends: bool) -> None:
    rig = Rig([False])
    rig.bring(S.HELD)
    (axis,), (drive,) = rig.axes, rig.drives
    drive.status, drive.obeys_not = REACTS, True
    with pytest.raises(DriveError):
        rig.run(0.1)
    rig.leave(0.5)
    assert rig.states == [S.FAULT]
    assert not axis.is_final
    if ends:
        drive.status = FAULT
    rig.leave(0.1 if ends else axis.quick_stop_s)
    assert axis.is_final
    assert axis.may_be_on is not ends


@pytest.mark.parametrize(("stopped_in", "silent"), [(READY, False), (READY, True), (ENABLED, False)])
def test_a_load_that_never_had_power_is_not_said_to_be_let_go(stopped_in: int, silent: bool) -> None:
    rig = Rig()
    drive = rig.drives[0]
    while drive.status != stopped_in:
        rig.run(CYCLE, W.HOLD)
    drive.propped, drive.lets_go, rig.silent = True, True, [silent]
    rig.run(0.02 * silent)
    rig.leave(9.0)
    assert rig.axes[0].was_let_go is (silent or stopped_in == ENABLED)


def test_a_load_that_comes_to_its_brake_in_motion_has_the_time_that_the_brake_was_seen_to_take() -> None:
    """Given it again, a drive that gives too little would open the brake."""
    rig = Rig(brake_s=0.05)
    (axis,), (drive,) = rig.axes, rig.drives
    axis.holding.seen = replace(axis.holding.seen, brake_s=0.05, brake_drop=0.009)
    rig.bring(S.STANDS)
    drive.holds_not = True
    drive.heard.clear()
    rig.leave(1.0)
    assert rig.states == [S.BRAKED]
    assert 15 not in drive.heard
    assert drive.position > -0.05


def test_a_load_without_a_brake_whose_torque_has_turned_sinks_slowly_until_it_rests_on_something() -> None:
    rig = Rig()
    rig.bring(S.LED)
    (axis,), (drive,) = rig.axes, rig.drives
    drive.follows = -1.0
    told: list[str] = []
    rig.supervisor.tell = told.append
    rig.supervisor.enter(axis, S.SLOWING)
    rig.leave(5.0)
    assert rig.states == [S.SLOWING]
    assert -1.0 < drive.position < -0.1
    assert abs(drive.speed) < 0.2
    assert told == ["support the load of A1: it is not seen to stand"]
    drive.supported = True
    rig.leave(1.0)
    assert rig.states == [S.FAULT]
    assert axis.was_let_go


@pytest.mark.parametrize("follows", [1.0, 0.5, -0.5, -1.0])
@pytest.mark.parametrize("is_held", [False, True])
def test_a_led_axis_that_its_torque_has_sped_up_the_opposite_way_is_not_left_to_its_drives_loop(
    follows: float, is_held: bool
) -> None:
    """Half as much is another mass than the stated one: then nobody knows."""
    turned = follows == -1.0
    rig = Rig([False])
    rig.bring(S.LED)
    drive = rig.drives[0]
    drive.follows = follows
    for k in range(100):
        rig.supervisor.tick(Wish([W.STAY], [12.0 * math.exp(10.0 * (k - 99) * CYCLE)]))
    if is_held and turned:
        with pytest.raises(SafetyStop, match="A1: its torque moved it the opposite way"):
            rig.run(CYCLE, W.HOLD)
    rig.leave(CYCLE)
    assert rig.states == [S.SLOWING if turned else S.PARKING]


@pytest.mark.parametrize("gap", [0.3, 2.0])
def test_an_axis_that_lets_go_within_a_second_of_another_that_was_cut_off_was_cut_off_too(gap: float) -> None:
    rig = Rig([True, True])
    rig.bring(S.HELD)
    rig.drives[0].status, rig.drives[0].propped = OFF, True
    with pytest.raises(DriveError):
        rig.run(0.1)
    rig.leave(gap)
    assert rig.states[0] is S.FAULT
    assert rig.states[1] in (S.PARKING, S.STANDS)
    rig.drives[1].status = OFF
    rig.leave(1.5)
    assert rig.states[1] is (S.FAULT if gap < 1.0 else S.CAUGHT)


@pytest.mark.parametrize("loads", [1, 3])
@pytest.mark.parametrize("state", [S.HELD, S.LED])
def test_whatever_lets_go_in_quick_stop_is_caught_at_once_and_held_until_it_is_supported(
    state: AxisState, loads: int
) -> None:
    rig = Rig([True] * loads)
    rig.bring(state)
    for drive in rig.drives:
        drive.lets_go = True
    said: list[str] = []
    rig.supervisor.tell = said.append
    rig.leave(5.0)
    assert rig.states == [S.CAUGHT] * loads
    assert all(d.position > -0.02 for d in rig.drives)
    sent = [t[0] for t in rig.torques]  # its weight, and what brakes its fall
    assert WEIGHT + 1.0 < max(sent) <= 20.0
    assert said[-1] == f"support the load of {', '.join(a.name for a in rig.axes)}: it is not seen to stand"
    for drive in rig.drives:
        drive.supported = True
    rig.leave(4.0)
    assert not any(d.status == ENABLED for d in rig.drives)


def test_what_nobody_supports_is_held_to_its_deadline_and_stopped_once_more() -> None:
    rig = Rig()
    rig.bring(S.HELD)
    rig.drives[0].lets_go = True
    rig.leave(SUPPORT_S - 1.0)
    assert rig.states == [S.CAUGHT]
    rig.leave(3.0)
    assert rig.axes[0].support_was_awaited
    assert rig.states == [S.LOST]


@pytest.mark.parametrize(("brake_s", "ends", "most"), [(0.03, S.BRAKED, 0.006), (0.5, S.STANDS, 0.02)])
def test_a_brake_is_tried_with_the_power_stage_on_and_one_that_is_late_is_taken_over(
    brake_s: float, ends: AxisState, most: float
) -> None:
    rig = Rig(brake_s=brake_s)
    rig.bring(S.HELD)
    rig.drives[0].heard.clear()
    rig.leave(6.0)
    assert rig.drives[0].heard[0] == 7
    assert (15 in rig.drives[0].heard) is (ends is S.STANDS)
    assert -rig.drives[0].position < most
    assert rig.axes[0].brake_failed is (ends is S.STANDS)
    if ends is S.STANDS:  # its drive holds it, by whom it was caught; somebody supports it
        rig.drives[0].supported = True
        rig.leave(3.0)
    assert rig.states == [ends]


@pytest.mark.parametrize(("brake_s", "most"), [(None, math.inf), (0.05, 0.04)])
def test_a_drive_that_gives_too_little_leaves_its_load_to_the_brake_and_else_is_said_to_hold_nothing(
    brake_s: float | None, most: float
) -> None:
    rig = Rig(brake_s=brake_s)
    rig.bring(S.HELD)
    rig.supervisor.is_leaving = True
    rig.drives[0].holds_not = True
    rig.run(1.5)
    assert -rig.drives[0].position < most
    assert rig.states == [S.BRAKED if brake_s else S.LOST]


def test_a_drive_that_is_not_seen_off_is_told_by_sdo_and_nmt_and_is_final_after_five_seconds() -> None:
    rig = Rig([False])
    rig.bring(S.LED)
    rig.drives[0].obeys_not = True
    rig.leave(4.0)
    assert rig.states == [S.UNHEARD]
    assert rig.axes[0].deaf
    assert (1, 2) in rig.told
    assert (1, 128) in rig.told
    assert (0, 0) in rig.told
    assert not rig.axes[0].is_final
    rig.leave(2.0)
    assert rig.axes[0].is_final


def test_a_load_that_is_held_in_position_mode_by_a_drive_that_does_not_obey_gets_no_nmt_stop() -> None:
    rig = Rig()
    rig.bring(S.HELD)
    rig.told.clear()
    rig.drives[0].obeys_not = True
    rig.leave(8.0)
    assert not [command for _, command in rig.told if command in (2, 128)]
    assert rig.drives[0].status == ENABLED


@pytest.mark.parametrize(("heard", "final"), [(True, True), (False, False)])
def test_what_a_drive_holds_is_final_while_it_is_heard_of_and_lost_a_second_later(
    heard: bool, final: bool
) -> None:
    rig = Rig()
    rig.bring(S.STANDS)
    rig.silent = [not heard]
    rig.leave(0.5)
    assert rig.states == [S.STANDS]
    assert rig.axes[0].is_final is final
    assert rig.asking == (set() if heard else {0})
    rig.leave(0.6)
    assert rig.states == [S.STANDS if heard else S.LOST]
    assert rig.axes[0].is_final


def test_after_a_pause_beyond_the_drives_watch_the_first_command_is_quick_stop() -> None:
    rig = Rig([True, False])
    rig.bring(S.HELD)
    rig.time += 0.2
    for drive in rig.drives:
        drive.heard.clear()
    rig.run(CYCLE)
    assert [d.heard for d in rig.drives] == [[2], [2]]
    again = Rig([True])
    again.bring(S.HELD)
    again.time += 0.1
    again.run(0.1)
    assert again.states == [S.HELD]


def test_a_fault_of_this_program_at_one_axis_leaves_no_other_unattended() -> None:
    rig = Rig([True, True])
    rig.bring(S.HELD)
    rig.axes[0].trouble = lambda: 1 / 0  # type: ignore[method-assign,assignment,return-value]
    rig.drives[1].holds_not = True
    with pytest.raises(DriveError, match=r"A1.*fault of this program"):
        rig.run(0.1)
    rig.leave(0.1)
    assert rig.states[1] in (S.CATCHING, S.LOST)


def test_a_silence_on_purpose_ends_at_the_first_load_that_lets_go_and_everyone_is_told_to_go_on() -> None:
    rig = Rig([True, True])
    rig.bring(S.HELD)
    for axis in rig.axes:
        axis.on_trial = True
    rig.supervisor.mute()
    assert not rig.beating
    rig.run(0.1)
    assert all(set(d.heard[-1:]) == {15} for d in rig.drives)
    rig.drives[0].status, rig.drives[1].status = OFF, STOPPED
    rig.told.clear()
    rig.run(0.02)
    assert rig.beating
    assert sorted(t for t in rig.told if t[1] == 1) == [(1, 1), (2, 1)]
    rig.run(1.0)
    assert rig.states == [S.CAUGHT, S.STANDS]
    assert -rig.drives[0].position < 0.02
    assert [a.verdict for a in rig.axes] == ["its drive left operation by itself", ""]


@pytest.mark.parametrize(("torque", "asked"), [(3.0, 3.0), (300.0, 20.0)])
def test_a_led_load_is_sent_what_is_wished_and_brought_to_rest_within_its_limit(
    torque: float, asked: float
) -> None:
    rig = Rig()
    rig.bring(S.LED)
    rig.supervisor.tick(Wish([W.STAY], [3.0]))
    assert rig.torques[-1] == [3.0]
    rig.supervisor.loops = [Loop(torque, 0.0)]
    rig.leave(CYCLE)
    assert rig.states == [S.STOPPING]
    assert rig.torques[-1] == [asked]


@pytest.mark.parametrize("silent_first", [True, False])
def test_a_led_load_that_is_not_seen_any_more_is_left_to_its_drives_own_stop(silent_first: bool) -> None:
    """The last speed that was seen would go on damping a motion that nobody knows."""
    rig = Rig()
    rig.bring(S.LED)
    rig.drives[0].speed = 1.0
    rig.drives[0].holds_not = True
    rig.supervisor.loops = [Loop(WEIGHT, 10.0)]
    rig.run(0.02)
    if not silent_first:
        rig.leave(0.02)
        assert rig.states == [S.STOPPING]
        assert rig.torques[-1] != [WEIGHT]
    rig.silent = [True]
    rig.drives[0].holds_not = False
    if silent_first:
        rig.run(0.01)
    rig.leave(0.01)
    assert rig.states == [S.PARKING]
    assert rig.drives[0].heard[-1] == 2
    rig.axes[0].state = S.STOPPING
    rig.run(CYCLE)
    assert rig.torques[-1] == [WEIGHT]


def test_a_drive_that_says_that_it_is_changing_its_mode_has_ten_seconds_more() -> None:
    rig = Rig()
    rig.bring(S.HELD)
    assert not rig.supervisor.is_changing
    rig.changes_s = 0.5
    rig.run(0.4, W.LEAD)
    assert rig.states == [S.LED]
    assert rig.supervisor.is_changing
    rig.run(0.2)
    assert not rig.supervisor.is_changing
    rig.changes_s = 8.0
    rig.run(7.9, W.HOLD)
    assert rig.states == [S.STOPPING]
    assert rig.supervisor.is_changing
    rig.run(0.5)
    assert rig.states == [S.HELD]
    rig.run(0.8, W.PARK)
    rig.operation, rig.changes_s = [OperationMode.CYCLIC_TORQUE], 4.0
    rig.run(4.4, W.HOLD)
    assert rig.states == [S.HELD]
    rig.run(9.0, W.LEAD)
    rig.changes_s = 60.0
    with pytest.raises(DriveError, match=r"A1.*without its mode"):
        rig.run(14.0, W.HOLD)
    assert rig.states == [S.PARKING]


@pytest.mark.parametrize(
    ("takes", "waits_in"), [(ModeSet.SHOWN, OFF), (ModeSet.LATER, ON), (ModeSet.TAKEN, ENABLED)]
)
def test_a_drive_goes_no_further_than_where_it_takes_the_mode_that_is_to_hold_it(
    takes: ModeSet, waits_in: int
) -> None:
    rig = Rig()
    rig.operation, rig.changes_s = [OperationMode.CYCLIC_TORQUE], 1.0
    rig.axes[0].takes_mode = takes
    rig.run(0.9, W.HOLD)
    assert rig.states == [S.HELD if takes is ModeSet.TAKEN else S.ENABLING]
    assert rig.drives[0].status == waits_in
    rig.run(0.3, W.HOLD)
    assert rig.states == [S.HELD]
    assert rig.operation == [OperationMode.CYCLIC_POSITION]


FACTS = {
    S.ENABLING: ({F.ENABLED, F.MODE}, S.HELD), S.SWITCHING: ({F.MODE}, S.ENABLING),
    S.STOPPING: ({F.ENABLED, F.MODE, F.STANDING}, S.HELD), S.PARKING: ({F.STOPPED, F.STANDING}, S.STANDS),
    S.BRAKING: ({F.UNPOWERED, F.STANDING}, S.BRAKED), S.CATCHING: ({F.ENABLED, F.MODE, F.STANDING}, S.CAUGHT),
    S.CAUGHT: ({F.SUPPORTED}, S.PARKING), S.LETTING_GO: ({F.UNPOWERED, F.STANDING}, S.OFF),
    S.UNHEARD: ({F.UNPOWERED}, S.OFF), S.SLOWING: ({F.STANDING}, S.LETTING_GO),
}  # fmt: skip


@pytest.mark.parametrize("state", S)
def test_a_state_ends_when_every_fact_of_it_is_seen_and_not_before(state: AxisState) -> None:
    facts, then = FACTS.get(state, (set(), state))
    for missing in (None, *facts):
        rig = Rig(brake_s=0.03)
        axis = rig.axes[0]
        axis.trouble = lambda: None  # type: ignore[method-assign]
        axis.shows = lambda fact, missing=missing: fact is not missing  # type: ignore[method-assign,misc]
        rig.run(CYCLE)
        axis.state, axis.since = state, rig.time
        rig.supervisor.is_leaving = state is S.SLOWING  # else it ends the run
        rig.run(CYCLE)
        assert axis.state is (then if missing is None else state)


@pytest.mark.parametrize(
    ("state", "load", "brake_s", "status", "after"),
    [
        (S.ENABLING, True, None, ENABLED, S.PARKING), (S.ENABLING, True, None, READY, S.LETTING_GO),
        (S.SWITCHING, True, None, OFF, S.FAULT), (S.STOPPING, True, 0.03, ENABLED, S.PARKING),
        (S.PARKING, True, 0.03, STOPPED, S.LOST), (S.PARKING, False, None, STOPPED, S.LETTING_GO),
        (S.BRAKING, True, 0.03, ON, S.CATCHING), (S.CATCHING, True, None, READY, S.CATCHING),
        (S.CATCHING, True, 0.03, READY, S.BRAKING), (S.CAUGHT, True, 0.03, ENABLED, S.PARKING),
        (S.LETTING_GO, False, None, STOPPED, S.UNHEARD), (S.UNHEARD, False, None, ENABLED, S.UNHEARD),
        (S.HELD, True, 0.03, ENABLED, S.HELD), (S.LED, True, 0.03, ENABLED, S.LED),
        (S.BRAKED, True, 0.03, OFF, S.BRAKED), (S.LOST, True, None, STOPPED, S.LOST),
    ],
)  # fmt: skip
def test_a_deadline_that_passes_leads_on(
    state: AxisState, load: bool, brake_s: float | None, status: int, after: AxisState
) -> None:
    rig = Rig([load], brake_s=brake_s)
    rig.supervisor.is_leaving, rig.silent = True, [True]
    axis = rig.axes[0]
    axis.shows = lambda fact: False  # type: ignore[method-assign]
    for seconds in (-0.02, 0.02):
        deadline = axis.quick_stop_s if state is S.PARKING else RULES[state].within_s
        axis.state, axis.status, axis.heard = state, status, rig.time
        axis.since = rig.time - (deadline if math.isfinite(deadline) else 900.0) - seconds
        rig.run(CYCLE)
        assert axis.state is (after if seconds > 0 else state)
        assert axis.brake_failed is (seconds > 0 and state is S.BRAKING)


@pytest.mark.parametrize(
    ("state", "load", "brake_s", "after"),
    [
        (S.HELD, True, 0.03, S.BRAKING), (S.HELD, True, None, S.PARKING), (S.HELD, False, None, S.LETTING_GO),
        (S.LED, False, None, S.PARKING), (S.LED, True, 0.03, S.BRAKING), (S.STANDS, True, None, S.STANDS),
    ],
)  # fmt: skip
def test_no_loop_that_a_dead_encoder_closes_is_believed(
    state: AxisState, load: bool, brake_s: float | None, after: AxisState
) -> None:
    rig = Rig([load], brake_s=brake_s)
    rig.bring(state)
    rig.supervisor.bounds.blind = {0}
    rig.run(CYCLE)
    assert rig.states == [after]


def test_a_load_that_falls_though_its_drive_is_still_on_is_left_to_its_brake_without_voltage() -> None:
    rig = Rig(brake_s=0.03)
    rig.bring(S.HELD)
    drive = rig.drives[0]
    drive.obeys_not = drive.holds_not = True
    rig.leave(0.1)
    assert rig.axes[0].power_is_useless
    assert [s for _, s in rig.axes[0].story].count(S.BRAKING) == 2
    assert drive.heard[-1] == 0


def test_a_drive_of_which_nothing_is_heard_is_told_by_nmt_once() -> None:
    rig = Rig([False])
    rig.bring(S.LED)
    assert rig.waits_for_power_off == [True]  # it stands without torque, should a mode be taken then only
    rig.silent = [True]
    rig.leave(3.0)
    assert rig.told.count((1, 2)) == 1
    held = Rig()
    held.bring(S.LED)
    assert held.waits_for_power_off == [False]


@pytest.mark.parametrize("state", S)
@pytest.mark.parametrize("brake_s", [None, 0.03])
def test_what_falls_goes_to_the_best_means_that_was_not_tried(
    state: AxisState, brake_s: float | None
) -> None:
    untried = S.CATCHING if brake_s is None else S.BRAKING
    after = {
        S.OFF: S.CATCHING, S.LETTING_GO: S.CATCHING, S.ENABLING: untried, S.HELD: untried,
        S.SWITCHING: untried, S.STANDS: untried, S.CAUGHT: untried, S.PARKING: untried,
        S.BRAKING: S.CATCHING, S.BRAKED: S.CATCHING,
        S.STOPPING: S.PARKING if brake_s is None else S.BRAKING,
        S.LED: S.LOST if brake_s is None else S.BRAKING,  # it gives less than it is asked for
        S.CATCHING: S.LOST if brake_s is None else S.BRAKING,
    }  # fmt: skip
    rig = Rig(brake_s=brake_s)
    rig.run(CYCLE)
    axis = rig.axes[0]
    axis.shows = lambda fact: False  # type: ignore[method-assign]
    axis.trouble = lambda: Trouble.FALLS  # type: ignore[method-assign]
    axis.state, axis.since = state, rig.time
    rig.supervisor.is_leaving = state is S.SLOWING  # else it ends the run
    rig.run(CYCLE)
    assert axis.state is after.get(state, state)
    assert axis.brake_failed is (state in (S.BRAKING, S.BRAKED))
    assert axis.weak is (state is S.LED)


@pytest.mark.parametrize("load", [True, False])
def test_the_way_out_ends_where_every_axis_stands_or_nothing_can_be_done_for_it(load: bool) -> None:
    axis = Rig([load]).axes[0]
    ends = []
    for axis.state in S:
        ends += [axis.state] * axis.is_final
    assert ends == [S.OFF, *[S.STANDS] * load, S.BRAKED, S.FAULT, S.LOST]
