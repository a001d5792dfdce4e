"""The cell: every drive on one bus, exchanged with once per SYNC. Implements ``invid.sweep.ports.Cell``.

Raw ``struct`` in the cycle; SDO, maps and states before and after it. Whoever energises also stops:
``stop`` works from any state, any number of times, and never raises.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Callable, Sequence

import can

from invid.config import CellConfig
from invid.errors import BusError, DriveError, InvidError, SafetyStop
from invid.sweep.ports import Clock, Event, Mode, Sample, Severity
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.axis import Drive, DriveReport
from invid_drivers.cia402.jitter import Jitter
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.link import ANSWER_S, NMT_PRE_OPERATIONAL, NMT_START, NMT_STOP, Link
from invid_drivers.cia402.runaway import RunawayGuard
from invid_drivers.cia402.states import DriveState, OperationMode, state_of
from invid_drivers.cia402.units import wrapped_difference

ENABLE_S = 3.0
"""Longest way to operation enabled: brakes take a few hundred milliseconds to open."""
QUICK_STOP_S = 1.0
"""Longest quick stop before the voltage is taken away regardless."""
DISABLE_S = 0.2
ENERGISED_ANSWER_S = 0.1
"""A request while axes follow their last torque waits so long for its answer, twice, or as long as the
config forgives missing TPDOs. Ten times what slow drives take; an axis that 0.1 N·m accelerates per kg·m²
moves by 2 mrad in the two. A guess."""
MODE_CHANGE_S = 0.2
"""Longest change of mode while axes follow their last torque; drives take some milliseconds. A guess."""
STATE_POLL_S = 0.005
"""Between two questions for the statusword by SDO, on the way out."""
UNCERTAIN_CYCLES = 0.2
"""Where reading the clock and sending SYNC took longer, the system paused this process in between: nobody
knows when SYNC was on the wire, and the positions of that cycle count as not received. At 3 rad/s a fifth
of a millisecond is 0.6 mrad."""
CLOSEST_CYCLES = 0.5
"""Two SYNCs are never closer: a drive that samples at SYNC may miss one that comes in half its cycle."""
ALONE_CYCLES = 3
"""After a gap, three cycles in a row that bring one TPDO, later than usual, do not say whether what was owed
is lost or the drive has fallen behind by whole cycles. A slot without SYNC does: nothing comes in it, or the
answer that is late."""
LISTEN_EVERY_S = 1.0
"""Where one TPDO was lost and the next came as fast as ever, that is asked at most so often: one slot in a
thousand at 1 kHz. A guess at what a record may lose."""
MODE_POLL_S = 0.1
"""0x6061 of one axis after another is asked for at this interval during the cycle."""
HEARTBEAT_PERIODS = 3.5
"""A drive's heartbeat is lost after this many periods: three missed ones and some jitter."""

_RAMPING = (DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE)
_RPDO = struct.Struct("<Hh")
_TPDO = struct.Struct("<ihH")
_MODE_REQUEST = bytes((0x40, od.MODE_DISPLAY.index & 0xFF, od.MODE_DISPLAY.index >> 8, 0, 0, 0, 0, 0))


class Cia402Cell:
    """Drives of a cell on a python-can bus, which it owns from here on."""

    def __init__(self, bus: can.BusABC, config: CellConfig, *, journal: Journal | None = None) -> None:
        self._config = config
        self._cycle = config.bus.cycle_s
        self._link = Link(bus, heartbeat_s=config.safety.heartbeat_s)
        self.journal = journal if journal is not None else Journal(None)
        self._drives = [Drive(self._link, a, self.journal, linear=config.linear) for a in config.axes]
        self._reports: list[DriveReport] = []
        count = len(self._drives)
        self._modes = [Mode.TORQUE] * count
        self._control = [states.DISABLE_VOLTAGE] * count
        self._rpdo_ids = [0x200 + d.node_id for d in self._drives]
        self._tpdo_axis = {0x180 + d.node_id: i for i, d in enumerate(self._drives)}
        self._sdo_axis = {0x580 + d.node_id: i for i, d in enumerate(self._drives)}
        self._peers = [self._link.peers[d.node_id] for d in self._drives]
        self._sync = can.Message(arbitration_id=0x80, data=b"", is_extended_id=False)
        self._origin: list[int | None] = [None] * count
        self._per_mille = [0.0] * count
        self._position_unit = [0.0] * count
        self._torque_unit = [0.0] * count
        self._sample = Sample(
            position=[0.0] * count, torque=[0.0] * count, status=[0] * count, fresh=[False] * count
        )
        self._started = 0.0
        self._sent = -math.inf
        self._slot = -1
        self._owed = [0] * count
        self._alone = [0] * count
        self._behind = [False] * count
        self._doubt = False
        self._next_listen = -math.inf
        self._answered_s = 0.5 * self._cycle
        self._operational = False
        self._touched = False
        self._mode_asked = 0
        self._next_mode_poll = 0.0
        self._stopped = True
        self._given_up: set[int] = set()
        self.held_at_end: tuple[str, ...] = ()
        """Gravity-loaded axes that their drives hold in quick stop active."""
        self.not_off: tuple[str, ...] = ()
        """Axes that were not seen to switch off."""
        self.cancelled: Callable[[], bool] = lambda: False
        """Asked while the drives are being enabled: brakes take their time, a stop must not."""
        self.skipped_slots = 0
        self.jitter = Jitter()

    # --- facts ---------------------------------------------------------------------------------
    @property
    def axes(self) -> tuple[str, ...]:
        """Names, in the order of every list."""
        return tuple(d.name for d in self._drives)

    @property
    def clock(self) -> Clock:
        """The clock that the SYNC instants are of."""
        return self._link.clock

    @property
    def reports(self) -> tuple[DriveReport, ...]:
        """What each drive said at ``check``."""
        return tuple(self._reports)

    @property
    def can_hold(self) -> tuple[bool, ...]:
        """Whether each drive can hold its place by itself."""
        return tuple(r.can_hold for r in self._reports)

    @property
    def resolution(self) -> tuple[float, ...]:
        """Position of one encoder count of each axis [rad or m]."""
        return tuple(r.scaling.position_per_count for r in self._reports)

    @property
    def rated_torque(self) -> tuple[float, ...]:
        """Rated torque of each axis [N·m or N]."""
        return tuple(r.scaling.rated_torque for r in self._reports)

    # --- before motion -------------------------------------------------------------------------
    def check(self) -> tuple[DriveReport, ...]:
        """Restore what an earlier run left behind, then ask every drive what it can do. Moves nothing."""
        self._link.require_bus()
        self._pre_operational()
        for drive in self._drives:
            if self.journal.of_node(drive.node_id):
                drive.restore()
        self._reports = [d.check() for d in self._drives]
        for i, r in enumerate(self._reports):
            self._position_unit[i] = r.scaling.direction * r.scaling.position_per_count
            self._torque_unit[i] = r.scaling.torque(1)
            self._per_mille[i] = 1.0 / self._torque_unit[i]
        return self.reports

    def _pre_operational(self) -> None:
        self._link.nmt(NMT_PRE_OPERATIONAL)
        self._link.wait(0.02)

    def energise(self, modes: Sequence[Mode]) -> None:
        """Protect, map, start and enable every drive at rest where it stands."""
        if not self._reports:
            self.check()
        self._stopped = False
        self._given_up.clear()
        self._touched = True
        self._link.beating = True
        self._pre_operational()
        for drive, report in zip(self._drives, self._reports, strict=True):
            drive.protect(report, self._config.safety.heartbeat_s)
            drive.map_pdos()
        self._modes = list(modes)
        for drive, report, mode in zip(self._drives, self._reports, modes, strict=True):
            drive.command(od.TARGET_TORQUE, 0)
            if mode is Mode.HOLD:
                drive.command(od.TARGET_POSITION, drive.read(od.POSITION))
            drive.set_mode(self._operation_mode(report, mode))
        self._link.events.clear()
        for peer in self._peers:
            peer.last_heartbeat = None
        self._link.nmt(NMT_START)
        self._link.wait(0.005)
        self._operational = True
        self._restart_slots()
        self._enable()

    def _operation_mode(self, report: DriveReport, mode: Mode) -> OperationMode:
        return report.torque_mode if mode is Mode.TORQUE else OperationMode.CYCLIC_POSITION

    def _enable(self) -> None:
        zero = [0.0] * len(self._drives)
        end = self.clock.now() + ENABLE_S
        self._control = [states.DISABLE_VOLTAGE] * len(self._drives)
        while True:
            sample = self.exchange(zero)
            for event in sample.events:
                if event.severity is not Severity.NOTE:
                    raise DriveError(f"{event.text} while it was being enabled")
            found = [state_of(s) for s in sample.status]
            if all(sample.fresh) and all(s is DriveState.OPERATION_ENABLED for s in found):
                return
            for i, state in enumerate(found):
                if sample.fresh[i]:
                    self._control[i] = states.towards_enabled(state)
            if self.cancelled():
                raise SafetyStop(
                    "stopped on request while the drives were being enabled; nothing was recorded yet"
                )
            if self.clock.now() >= end:
                i = next(
                    (
                        k
                        for k, s in enumerate(found)
                        if not sample.fresh[k] or s is not DriveState.OPERATION_ENABLED
                    )
                )
                seen = found[i].words if sample.fresh[i] else "silence (no TPDO comes)"
                raise DriveError(
                    f"axis {self.axes[i]} (node {self._drives[i].node_id}): not enabled after "
                    f"{ENABLE_S:g} s, the drive "
                    f"shows {seen}; check its supply, its enable input, safe torque off and the brake"
                )

    def set_modes(self, modes: Sequence[Mode], torque: Sequence[float]) -> None:
        """Change modes while energised; an axis that is to be held keeps its present place.

        No cycle runs meanwhile and the other axes keep their last torque: nobody waits long for a drive.
        """
        silence = self._config.safety.missed_tpdos * self._cycle
        self._link.answer_s = min(ANSWER_S, max(ENERGISED_ANSWER_S, silence))
        try:
            self._set_modes(modes, torque)
        finally:
            self._link.answer_s = ANSWER_S
        self._restart_slots()

    def _set_modes(self, modes: Sequence[Mode], torque: Sequence[float]) -> None:
        for i, (drive, report, mode) in enumerate(zip(self._drives, self._reports, modes, strict=True)):
            if mode is self._modes[i]:
                continue
            if mode is Mode.HOLD:
                drive.command(od.TARGET_POSITION, drive.read(od.POSITION))
            else:
                drive.command(od.TARGET_TORQUE, report.scaling.permille(torque[i]))
            drive.set_mode(self._operation_mode(report, mode), MODE_CHANGE_S)
            self._modes[i] = mode

    def _restart_slots(self) -> None:
        """The next SYNC is at the next whole slot from now: SDO traffic took time of its own."""
        now = self.clock.now()
        if self._slot < 0:
            self._started, self._slot = now, -1
        else:
            self._slot = max(self._slot, int((now - self._started) / self._cycle))
        self._owed = [0] * len(self._drives)
        self._doubt = False

    # --- the cycle -----------------------------------------------------------------------------
    def exchange(self, torque: Sequence[float]) -> Sample:
        """Targets out, SYNC at its slot, samples in."""
        link, clock = self._link, self.clock
        sample, put = self._sample, link.put
        hold = Mode.HOLD
        if self._doubt:
            self._listen()
        for i, cob in enumerate(self._rpdo_ids):
            value = 0 if self._modes[i] is hold else round(torque[i] * self._per_mille[i])
            if value > 32767 or value < -32768:
                value = 32767 if value > 0 else -32768
            put(
                can.Message(
                    arbitration_id=cob, data=_RPDO.pack(self._control[i], value), is_extended_id=False
                )
            )
        self._drain()
        slot, deadline, instant = self._wait_for_slot()
        put(self._sync)
        self._sent = clock.now()
        certain = self._sent - instant < UNCERTAIN_CYCLES * self._cycle
        self._slot = slot
        self.jitter.add(instant - deadline)
        sample.slot, sample.time = slot, instant
        self._collect(instant, deadline + 0.85 * self._cycle)
        fresh = sample.fresh
        if not certain:
            for i in range(len(fresh)):
                fresh[i] = False
        link.beat(instant)
        if instant >= self._next_mode_poll:
            self._watch_slowly(instant)
        if link.events:
            sample.events = link.events
            link.events = []
        elif sample.events:
            sample.events = []
        return sample

    def _collect(self, instant: float, end: float) -> None:
        """TPDOs of the SYNC at ``instant`` until all came or ``end``.

        Where an earlier one has not come, it was lost or is still under way (a simulated drive on a busy
        computer, a slow gateway). What comes then is this SYNC's only if it comes alone and as fast as
        ever, or last of as many as are owed; else nobody knows, and the axis counts as not received. One
        that comes alone may also be of a drive that answers a cycle late from now on: ``_listen`` tells.
        """
        clock, get, owed = self.clock, self._link.get, self._owed
        fresh = self._sample.fresh
        for i in range(len(fresh)):
            fresh[i] = False
        pending = len(fresh)
        waiting = any(owed)
        came = [0] * len(fresh)
        last = instant
        tpdo_axis = self._tpdo_axis
        while pending or waiting:
            rest = end - clock.now()
            if rest <= 0:
                break
            message = get(rest)
            if message is None:
                break
            axis = tpdo_axis.get(message.arbitration_id)
            if axis is None:
                self._sort(message)
            elif self._take(axis, message):
                came[axis] += 1
                if waiting:
                    last = clock.now()
                if not fresh[axis]:
                    fresh[axis] = True
                    pending -= 1
                    if not pending and not waiting:
                        self._answered_s += 0.05 * (clock.now() - instant - self._answered_s)
        if pending or waiting:
            in_time = last - instant < 1.5 * self._answered_s + 0.1 * self._cycle
            for i, count in enumerate(came):
                missing = owed[i] + 1 - count
                single = count == 1 and missing > 0
                self._alone[i] = self._alone[i] + 1 if single else 0
                if single and in_time and not self._behind[i]:
                    missing = self._alone[i] = 0
                    self._doubt = self._doubt or instant >= self._next_listen
                elif count and missing <= 0:
                    missing = 0
                    self._behind[i] = False
                else:
                    fresh[i] = False
                    self._doubt = self._doubt or self._alone[i] >= ALONE_CYCLES
                owed[i] = missing
        elif any(self._behind):
            self._behind = [False] * len(fresh)  # nothing was owed, and every answer came in its own cycle

    def _listen(self) -> None:
        """Slots without SYNC, until one passes in which no TPDO comes: whose comes then has fallen behind.

        From there on nothing is owed, and a drive that was behind is believed again when it has answered a
        SYNC in its own cycle. The drives go on with their last targets meanwhile.
        """
        late = set()
        self._doubt = False
        self._next_listen = self.clock.now() + LISTEN_EVERY_S
        for _ in range(self._config.safety.missed_tpdos):
            self._slot += 1
            self.skipped_slots += 1
            end = self._started + (self._slot + 0.85) * self._cycle
            heard = set()
            self._link.beat(self.clock.now())
            while True:
                rest = end - self.clock.now()
                message = self._link.get(max(rest, 0.0))
                if message is None:
                    if (
                        rest <= 0
                    ):  # what is there already was looked at too: this process may have been paused
                        break
                elif (axis := self._tpdo_axis.get(message.arbitration_id)) is None:
                    self._sort(message)
                else:
                    heard.add(axis)
            late |= heard
            if not heard:
                break
        count = len(self._drives)
        self._owed, self._alone = [0] * count, [0] * count
        self._behind = [self._behind[i] or i in late for i in range(count)]

    def _wait_for_slot(self) -> tuple[int, float, float]:
        """Number, deadline and instant of the next SYNC, at its slot or at most half a cycle late.

        Whoever is later, because the targets took long or because the system woke this process late, goes
        on to the next slot still ahead: a pause is never made up for by a burst. Nor is one in the middle of
        sending SYNC, after which the frame may have left at any moment until ``_sent``: a slot less than half
        a cycle after that is skipped. So two SYNCs are never closer than half a cycle.
        """
        clock, cycle = self.clock, self._cycle
        slot = self._slot + 1
        while True:
            deadline = self._started + slot * cycle
            if deadline - self._sent >= CLOSEST_CYCLES * cycle:
                if clock.now() <= deadline:
                    clock.sleep_until(deadline)
                self._drain()  # it may have taken its time: only now is it known how late SYNC is
                instant = clock.now()
                if instant <= deadline + CLOSEST_CYCLES * cycle:
                    return slot, deadline, instant
                self.jitter.add(instant - deadline)
            else:
                instant = self._sent
            ahead = max(int((instant - self._started) / cycle), slot) + 1
            self.skipped_slots += ahead - slot
            slot = ahead

    def _take(self, axis: int, message: can.Message) -> bool:
        data = message.data
        if len(data) != 8 or message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            self._link.sort(message)
            return False
        counts, permille, status = _TPDO.unpack(data)
        origin = self._origin[axis]
        if origin is None:
            origin = self._origin[axis] = counts
        moved = counts - origin
        if moved > 0x7FFFFFFF or moved < -0x80000000:
            moved = wrapped_difference(counts, origin)
        sample = self._sample
        sample.position[axis] = (origin + moved) * self._position_unit[axis]
        sample.torque[axis] = permille * self._torque_unit[axis]
        sample.status[axis] = status
        return True

    def _sort(self, message: can.Message) -> None:
        axis = self._sdo_axis.get(message.arbitration_id)
        if axis is None or message.is_error_frame:
            self._link.sort(message)
            return
        self._link.answered(self._drives[axis].node_id)
        data = bytes(message.data)
        if len(data) == 8 and data[1:4] == _MODE_REQUEST[1:4] and data[0] & 0xE0 == 0x40:
            shown = int.from_bytes(data[4:5], "little", signed=True)
            wanted = self._operation_mode(self._reports[axis], self._modes[axis])
            if shown != int(wanted):
                self._link.events.append(
                    Event(
                        Severity.DRIVE,
                        f"axis {self.axes[axis]}: the drive left mode {wanted.name.lower()} for mode "
                        f"{shown} (0x6061)",
                        self.axes[axis],
                    )
                )

    def _drain(self) -> None:
        """Before a SYNC: what is there belongs to an earlier one and would pass for this one's."""
        while (message := self._link.get(0)) is not None:
            axis = self._tpdo_axis.get(message.arbitration_id)
            if axis is None:
                self._sort(message)
            elif self._owed[axis]:
                self._owed[axis] -= 1

    def _watch_slowly(self, now: float) -> None:
        """Heartbeats and bus state; 0x6061 of one axis after another."""
        self._next_mode_poll = now + MODE_POLL_S
        self._link.require_bus()
        limit = HEARTBEAT_PERIODS * self._config.safety.heartbeat_s
        for drive, peer in zip(self._drives, self._peers, strict=True):
            if peer.last_heartbeat is not None and now - peer.last_heartbeat > limit:
                self._link.events.append(
                    Event(
                        Severity.DRIVE,
                        f"axis {drive.name} (node {drive.node_id}): no heartbeat for "
                        f"{now - peer.last_heartbeat:.2f} s",
                        drive.name,
                    )
                )
        self._mode_asked = (self._mode_asked + 1) % len(self._drives)
        self._link.ask(self._drives[self._mode_asked].node_id, _MODE_REQUEST)

    # --- the way out ---------------------------------------------------------------------------
    def stop(self) -> None:
        """Quick stop, disable voltage, NMT stop; idempotent, from any state, never raises.

        Whatever fails in one step, the next ones are still taken. Where it is interrupted itself (a second
        Ctrl-C), the next call begins again.
        """
        if self._stopped:
            return
        began = self.clock.now()
        with contextlib.suppress(Exception):
            self._control = [states.QUICK_STOP] * len(self._drives)
            guard = RunawayGuard(self._config)
            self._drive_to(QUICK_STOP_S, lambda s: self._cut_runaways(guard, s) or self._at_rest(s))
        for i in range(len(self._drives)):
            if self._may_disable(i):
                self._control[i] = states.DISABLE_VOLTAGE
        self.held_at_end = tuple(d.name for i, d in enumerate(self._drives) if not self._may_disable(i))
        with contextlib.suppress(Exception):
            self._drive_to(DISABLE_S, self._disabled)
        unsure = [i for i in range(len(self._drives)) if self._may_disable(i) and self._may_be_on(i)]
        on = []
        for i in unsure:
            off = False
            with contextlib.suppress(Exception):
                off = self._switch_off_by_sdo(i, began + QUICK_STOP_S)
            if not off:
                on.append(self._drives[i].name)
        self.not_off = tuple(on)
        for i, drive in enumerate(self._drives):
            if self._may_disable(i):
                with contextlib.suppress(Exception):
                    self._link.nmt(NMT_STOP, drive.node_id)
        self._stopped = True

    def _may_be_on(self, axis: int) -> bool:
        """By its last TPDO: one that has not come, or came late, says nothing."""
        return not self._sample.fresh[axis] or states.is_energised(state_of(self._sample.status[axis]))

    def _switch_off_by_sdo(self, axis: int, ramp_ends: float) -> bool:
        """Ask a drive whose TPDOs did not show it off, switch it off where it is not; whether it is off.

        TPDOs that come late (a busy computer) or not at all do not say that SDO is dead too. A drive that
        does not answer is told to switch off all the same: it may hear.
        """
        drive, clock = self._drives[axis], self.clock
        if axis in self._given_up:
            self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)  # NMT stopped, it would not answer
        state = drive.quiet_state()
        if state is None:
            drive.shout(od.CONTROLWORD, states.DISABLE_VOLTAGE)
            return False
        while state in _RAMPING and clock.now() < ramp_ends:
            self._link.wait(STATE_POLL_S)
            state = drive.quiet_state()
        if state is None or not states.is_energised(state):
            return state is not None
        drive.quiet_command(od.CONTROLWORD, states.DISABLE_VOLTAGE)
        end = clock.now() + DISABLE_S
        while (state := drive.quiet_state()) is not None and states.is_energised(state):
            if clock.now() >= end:
                return False
            self._link.wait(STATE_POLL_S)
        return state is not None

    def _may_disable(self, axis: int) -> bool:
        """A gravity-loaded axis without a brake stays in quick stop active, which holds it."""
        config = self._drives[axis].config
        return not config.gravity_loaded or config.brake == "drive"

    def _cut_runaways(self, guard: RunawayGuard, sample: Sample) -> bool:
        """An axis that a quick stop makes faster has a wrong sign somewhere: only cutting it off helps."""
        for i in guard.faster(sample):
            self._control[i] = states.DISABLE_VOLTAGE  # the one case in which a loaded axis is let go
        for i in guard.silent(sample):
            # It may hear NMT though its PDOs are lost; its abort option (0x6007) is a quick stop.
            if i not in self._given_up:
                self._given_up.add(i)
                self._link.nmt(NMT_STOP, self._drives[i].node_id)
        return False

    def _drive_to(self, seconds: float, reached: Callable[[Sample], bool]) -> None:
        zero = [0.0] * len(self._drives)
        end = self.clock.now() + seconds
        missing = 0
        while self.clock.now() < end:
            try:
                sample = self.exchange(zero)
            except BusError:
                missing += 1
                if missing > 3:
                    raise
                self._link.wait(self._cycle)
                continue
            if reached(sample):
                return

    def _at_rest(self, sample: Sample) -> bool:
        """Every drive that talks has left operation enabled and, where it stays energised, stands."""
        for i, status in enumerate(sample.status):
            if i in self._given_up:
                continue
            if not sample.fresh[i]:
                return False
            match state_of(status):
                case DriveState.OPERATION_ENABLED | DriveState.FAULT_REACTION_ACTIVE:
                    return False
                case DriveState.QUICK_STOP_ACTIVE:
                    if self._may_disable(i):
                        return False  # option 2: the drive switches itself off when the ramp has ended
                case _:
                    pass
        return True

    def _disabled(self, sample: Sample) -> bool:
        return all(
            sample.fresh[i] and (not self._may_disable(i) or not states.is_energised(state_of(s)))
            for i, s in enumerate(sample.status)
        )

    def states(self) -> dict[str, DriveState]:
        """The last state heard of each drive."""
        return {d.name: state_of(s) for d, s in zip(self._drives, self._sample.status, strict=True)}

    def close(self) -> list[str]:
        """Stop, restore every object that was written, close the bus; what could not be restored."""
        complaints: list[str] = []
        self.stop()
        try:
            if self._touched or self.journal.entries:
                self._restore(complaints)
        except InvidError as error:
            complaints.append(str(error))
        finally:
            self._link.beating = False
            self._link.close()
            self.journal.release()
        return complaints

    def _restore(self, complaints: list[str]) -> None:
        left = self._left_protected(complaints)
        for drive in self._drives:
            if drive.name not in left:
                self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)
        self._link.wait(0.02)
        for drive in self._drives:
            if drive.name in left:
                continue
            try:
                drive.restore()
            except InvidError as error:
                complaints.append(str(error))

    def _left_protected(self, complaints: list[str]) -> set[str]:
        """Axes that keep their heartbeat watch and limits until the next start, because they may be on."""
        for name in self.held_at_end:
            complaints.append(
                f"axis {name} is held by its drive in quick stop active; its objects are restored at the "
                "next start. Set the brake before switching it off"
            )
        for name in self.not_off:
            complaints.append(
                f"axis {name} was not seen to switch off; its objects, its heartbeat watch among them, stay "
                "as they are until the next start"
            )
        return {*self.held_at_end, *self.not_off}
