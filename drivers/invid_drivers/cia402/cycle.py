"""One cycle of every drive: targets out, SYNC at its slot, samples in, in raw ``struct``.

Two promises: two SYNCs are never closer than half a cycle, and a sample is never logged with a SYNC that it
may not belong to.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import can

from invid.config import CellConfig
from invid.errors import BusError
from invid.sweep.ports import Event, Sample, Severity
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.cycle_requests import EVERY_CYCLES, Change, StateQuestion, upload
from invid_drivers.cia402.jitter import Jitter
from invid_drivers.cia402.link import Link
from invid_drivers.cia402.objects import NodeAxis, Object
from invid_drivers.cia402.stated.scales import WHOLE, wrapped_difference
from invid_drivers.cia402.states import DriveState, OperationMode, state_of

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
APART_S = 0.05
"""For an answer that is owed is waited so long before the next SYNC where they are kept apart: no adapter
holds a frame longer (a USB latency timer: 16 ms)."""
LISTEN_EVERY_S = 1.0
"""Where one TPDO was lost and the next came as fast as ever, that is asked at most so often: one slot in a
thousand at 1 kHz. A guess at what a record may lose."""
MODE_POLL_S = 0.1
"""0x6061 of one axis after another is asked for at this interval during the cycle."""
FLOOD_S, MOST_WAITING = 1.0, 50_000
"""Longer than that nobody works off what has come, and more frames than two seconds of a full bus bring do
not wait for a cycle: a node babbles."""
FLOODED = "the bus is flooded: more frames come than this computer can look at; find the node that babbles"
HEARTBEAT_PERIODS = 3.5
"""A drive's heartbeat is lost after this many periods: three missed ones and some jitter."""

_RPDO = struct.Struct("<Hh")
_TPDO = struct.Struct("<ihH")


class Cycle:
    """The exchange of process data with the drives of a cell, and what is watched beside it."""

    def __init__(self, link: Link, config: CellConfig) -> None:
        self._link = link
        self._config = config
        self._cycle = config.bus.cycle_s
        nodes = [a.node_id for a in config.axes]
        count = len(nodes)
        self.operation: list[OperationMode | None] = [None] * count
        """What 0x6061 of each axis is to show."""
        self.control = [states.DISABLE_VOLTAGE] * count
        """Controlword of each axis in the next cycle."""
        self.sample = Sample(
            position=[0.0] * count,
            torque=[0.0] * count,
            status=[0] * count,
            fresh=[False] * count,
            late=[False] * count,
        )
        self.waits_for_power_off = [False] * count
        """Whether an axis may be switched off for a mode that its drive takes without power only."""
        self.asked = [0.0] * count
        """Torque that each axis was sent with the last SYNC [N·m or N]; 0 where its drive holds it, or
        may."""
        self.paused = False
        """No SYNC was sent on purpose, since somebody has looked."""
        self.skipped_slots = 0
        self.jitter = Jitter()
        self._of_node = [NodeAxis(a.axis_of_node) for a in config.axes]
        places = list(zip(self._of_node, nodes, strict=True))
        self._rpdo_ids = [axis.cob_id("RPDO", n) for axis, n in places]
        self._tpdo_axis = {axis.cob_id("TPDO", n): i for i, (axis, n) in enumerate(places)}
        self._sdo_axes = {0x580 + n: [i for i, m in enumerate(nodes) if m == n] for n in nodes}
        self._mode_requests = [upload(axis.at(od.MODE_DISPLAY)) for axis in self._of_node]
        self._nodes = nodes
        self._peers = [link.peers[n] for n in nodes]
        self._sync = can.Message(arbitration_id=0x80, data=b"", is_extended_id=False)
        self._origin: list[int | None] = [None] * count
        self._per_mille = [0.0] * count
        self._most = [32767] * count
        self._position_unit = [0.0] * count
        self._span = [WHOLE] * count
        self._torque_unit = [0.0] * count
        self._started = 0.0
        self._sent = -math.inf
        self._overslept = False
        """Nothing of this computer ran for longer than the drives wait for their master."""
        self._slot = -1
        self._owed = [0] * count
        self._alone = [0] * count
        self._behind = [False] * count
        self._doubt = False
        self.apart = False
        """A SYNC waits for the answers to those before it: then what comes is its own, however late others
        are."""
        self._next_listen = -math.inf
        self._answered_s = 0.5 * self._cycle
        self._mode_asked = 0
        self._changes: dict[int, Change] = {}
        self._changes_asked = 0
        self.asking: set[int] = set()
        """Axes that are asked for state and place by SDO: their process data do not come."""
        self._questions = [StateQuestion(axis) for axis in self._of_node]
        self._order = list(range(count))
        self._told: set[int] = set()
        """Axes of which an SDO answer told a place, or a state, since the last cycle."""
        self._counts = [0] * count
        self._next_mode_poll = 0.0

    def scale(
        self, axis: int, *, position: float, torque: float, most: int = 32767, span: int = WHOLE
    ) -> None:
        """Set the position of one count [rad or m] and the torque of one thousandth [N·m or N], with signs.

        ``most``: thousandths that are never exceeded; a target rounded up would pass its limit. ``span``:
        counts after which 0x6064 begins again.
        """
        self._span[axis] = span
        self._position_unit[axis] = position
        self._torque_unit[axis] = torque
        self._per_mille[axis] = 1.0 / torque
        self._most[axis] = most

    @property
    def permille(self) -> list[int]:
        """Size of the torque that each drive showed last [‰ of rated]."""
        return [round(abs(t / u)) for t, u in zip(self.sample.torque, self._torque_unit, strict=True)]

    def change(self, axis: int, operation: OperationMode, *, taken: bool = False) -> None:
        """Ask a drive for another mode, in the cycles to come.

        From now on until it shows its mode, an axis is sent torque: it follows that as soon as it is in
        torque mode, and until it holds. ``taken``: it has the mode, and is only to show it.
        """
        held = operation is OperationMode.CYCLIC_POSITION
        steps = [od.TARGET_POSITION] * held + [od.MODE] * (not taken) + [od.MODE_DISPLAY]
        self._changes[axis] = Change(self._of_node[axis], steps, int(operation), self._link.clock.now())

    def change_of(self, axis: int) -> Change | None:
        """The change of mode that goes on at an axis."""
        change = self._changes.get(axis)
        return None if change is None or change.operation is None else change

    def drop_change(self, axis: int) -> None:
        """Go on no longer with the mode that was asked for."""
        if self.change_of(axis) is not None:
            del self._changes[axis]

    @property
    def is_changing(self) -> bool:
        """Whether something asked of a drive beside the cycle has not been answered."""
        return bool(self._changes)

    def is_free_for_sdo(self, axis: int) -> bool:
        """Whether nothing is being written to a drive."""
        return axis not in self._changes

    def has_taken(self, axis: int) -> bool:
        """Whether a drive has taken the mode that it was asked for in the cycle."""
        change = self.change_of(axis)
        return change is None or change.taken

    def is_in(self, axis: int, operation: OperationMode) -> bool:
        """Whether a drive shows a mode."""
        return self.operation[axis] is operation and axis not in self._changes

    def place_of(self, axis: int, counts: int) -> float:
        """Position [rad or m] of counts that were read beside the cycle."""
        origin = self._origin[axis]
        moved = 0 if origin is None else wrapped_difference(counts, origin, self._span[axis])
        return ((origin or 0) + moved if origin is not None else counts) * self._position_unit[axis]

    def set_object(self, axis: int, what: Object, value: int) -> None:
        """Write an object of a drive in the cycles to come, while ``changing``."""
        self._changes[axis] = Change(self._of_node[axis], [what], value, self._link.clock.now())

    def restart_slots(self) -> None:
        """Let the next SYNC be at the next whole slot from now, after SDO traffic that took its time."""
        now = self._link.clock.now()
        self.paused = True
        if self._slot < 0:
            self._started, self._slot = now, -1
        else:
            self._slot = max(self._slot, int((now - self._started) / self._cycle))
        self._owed = [0] * len(self._nodes)
        self._doubt = False

    def exchange(self, torque: Sequence[float]) -> Sample:
        """Send the targets, SYNC at its slot, and return the samples that answer it."""
        link, clock = self._link, self._link.clock
        sample, put = self.sample, link.put
        sample.listened = 0
        if self._doubt or self.apart:
            self._listen()
        for i, cob in enumerate(self._rpdo_ids):
            value = max(-self._most[i], min(self._most[i], round(torque[i] * self._per_mille[i])))
            by_torque = self.operation[i] is not OperationMode.CYCLIC_POSITION and i not in self._changes
            self.asked[i] = value * self._torque_unit[i] if by_torque else 0.0
            put(
                can.Message(arbitration_id=cob, data=_RPDO.pack(self.control[i], value), is_extended_id=False)
            )
        self._drain()
        slot, deadline, instant = self._wait_for_slot()
        if self._overslept:  # what was put before is not for drives that have stopped by themselves since
            self._slot, sample.slot, sample.time = slot, slot, instant
            sample.fresh[:] = [False] * len(self._nodes)
            return sample
        put(self._sync)
        self._sent = clock.now()
        certain = self._sent - instant < UNCERTAIN_CYCLES * self._cycle
        self._slot = slot
        self.jitter.add(instant - deadline)
        sample.slot, sample.time = slot, instant
        self._collect(instant, deadline + 0.85 * self._cycle)
        fresh = sample.fresh
        if not certain:
            fresh[:] = [False] * len(fresh)
        sample.late[:] = [late and not came for late, came in zip(sample.late, fresh, strict=True)]
        link.beat(instant)
        self._ask_beside(instant)
        return sample

    def silent_cycle(self) -> Sample:
        """Let a slot pass in which nothing is commanded: drives are only asked, which is no sign of life."""
        link, sample = self._link, self.sample
        self._slot += 1
        end = self._started + self._slot * self._cycle
        while (rest := end - link.clock.now()) > 0:
            message = link.get(rest)
            if message is not None:
                self._sort(message)
        sample.slot, sample.time = self._slot, link.clock.now()
        sample.fresh[:] = [False] * len(self._nodes)
        self._ask_beside(sample.time)
        return sample

    def _ask_beside(self, instant: float) -> None:
        """Ask drives by SDO what the cycle does not tell, and hand out what was heard besides it."""
        link, sample = self._link, self.sample
        if self.asking:
            self._ask_states()
        if self._changes:
            self._go_on_changing(instant)
        elif instant >= self._next_mode_poll and not self.asking:
            self._watch_slowly(instant)
        if link.events:
            sample.events = link.events
            link.events = []
        elif sample.events:
            sample.events = []

    def _ask_states(self) -> None:
        for axis in [i for i in self._order if i in self.asking]:
            if axis not in self._changes and self._link.ask(
                self._nodes[axis], self._questions[axis].request()
            ):
                self._order.remove(axis)  # the next time another axis of its node comes first
                self._order.append(axis)
            if axis in self._told and not self.sample.fresh[axis]:
                self.sample.fresh[axis] = True
        self._told.clear()

    def _collect(self, instant: float, end: float) -> None:
        """Take in the TPDOs of the SYNC at ``instant`` until all came or ``end``.

        Where an earlier one has not come, it was lost or is still under way (a simulated drive on a busy
        computer, a slow gateway). What comes then is this SYNC's only if it comes alone and as fast as
        ever, or last of as many as are owed; else nobody knows, and the axis counts as not received. One
        that comes alone may also be of a drive that answers a cycle late from now on: ``_listen`` tells.
        """
        clock, get, owed = self._link.clock, self._link.get, self._owed
        fresh = self.sample.fresh
        fresh[:] = [False] * len(fresh)
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
                    self.sample.late[i] |= count > 0
                    self._doubt = self._doubt or self._alone[i] >= ALONE_CYCLES
                owed[i] = missing
        elif any(self._behind):
            self._behind = [False] * len(fresh)  # nothing was owed, and every answer came in its own cycle

    def _listen(self) -> None:
        """Pass slots without SYNC until one brings no TPDO: a drive whose TPDO comes then has fallen behind.

        Then two have to bring none: of what comes whole cycles late, one may come a moment early. Where SYNCs
        are kept apart, silence before an answer that is owed ends nothing.

        From there on nothing is owed, and a drive that was behind is believed again when it has answered a
        SYNC in its own cycle. The drives go on with their last targets meanwhile.
        """
        late: set[int] = set()
        silent, owed = 0, list(self._owed)
        patience = round(APART_S / self._cycle)
        self._doubt = False
        self._next_listen = self._link.clock.now() + LISTEN_EVERY_S
        for _ in range(self._config.safety.missed_tpdos):
            self._slot += 1
            self.sample.listened += 1
            end = self._started + (self._slot + 0.85) * self._cycle
            heard = set()
            self._link.beat(self._link.clock.now())
            while True:
                rest = end - self._link.clock.now()
                message = self._link.get(max(rest, 0.0))
                if message is None:
                    if rest <= 0:  # what is there already was looked at: this process may have been paused
                        break
                elif rest <= -FLOOD_S:
                    raise BusError(FLOODED)
                elif (axis := self._tpdo_axis.get(message.arbitration_id)) is None:
                    self._sort(message)
                else:
                    heard.add(axis)
                    owed[axis] -= 1
            late |= heard
            silent = 0 if heard else silent + 1
            if silent > (patience if self.apart and max(owed) > 0 else bool(late)):
                break
        count = len(self._nodes)
        self._owed, self._alone = [0] * count, [0] * count
        self._behind = [self._behind[i] or i in late for i in range(count)]

    def _wait_for_slot(self) -> tuple[int, float, float]:
        """Number, deadline and instant of the next SYNC, at its slot or at most half a cycle late.

        Whoever is later, because the targets took long or because the system woke this process late, goes
        on to the next slot still ahead: a pause is never made up for by a burst. Nor is one in the middle of
        sending SYNC, after which the frame may have left at any moment until ``_sent``: a slot less than half
        a cycle after that is skipped. So two SYNCs are never closer than half a cycle. A computer that is
        always late sends SYNC all the same once it has skipped more slots than are forgiven: the drives get
        their targets, and whoever makes the cycle ends it.
        """
        clock, cycle = self._link.clock, self._cycle
        slot = self._slot + 1
        last = slot + self._config.safety.overrun_cycles
        self._overslept = False
        while True:
            deadline = self._started + slot * cycle
            if deadline - self._sent >= CLOSEST_CYCLES * cycle:
                asleep = max(clock.now(), deadline)
                if clock.now() <= deadline:
                    clock.sleep_until(deadline)
                self._drain()  # it may have taken its time: only now is it known how late SYNC is
                instant = clock.now()
                self._overslept |= instant - asleep > 3 * self._link.heartbeat_s
                if instant <= deadline + CLOSEST_CYCLES * cycle or slot > last:
                    return slot, deadline, instant
                self.jitter.add(instant - deadline)
            else:
                instant = self._sent
            self._link.beat(clock.now())
            ahead = max(int((instant - self._started) / cycle), slot) + 1
            self.skipped_slots += ahead - slot
            slot = ahead

    def _take(self, axis: int, message: can.Message) -> bool:
        data = message.data
        if len(data) != 8 or message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            self._link.sort(message)
            return False
        counts, permille, status = _TPDO.unpack(data)
        self._counts[axis] = counts
        origin = self._origin[axis]
        if origin is None:
            origin = self._origin[axis] = counts
        moved = counts - origin
        if abs(moved) >= self._span[axis] // 2:
            moved = wrapped_difference(counts, origin, self._span[axis])
        sample = self.sample
        sample.position[axis] = (origin + moved) * self._position_unit[axis]
        sample.torque[axis] = permille * self._torque_unit[axis]
        if status != sample.status[axis]:
            sample.status[axis] = status
            self._link.gate.saw(self._nodes[axis], self._of_node[axis].number, status)
        return True

    def _sort(self, message: can.Message) -> None:
        axes = self._sdo_axes.get(message.arbitration_id)
        if axes is None or message.is_error_frame:
            self._link.sort(message)
            return
        self._link.answered(self._nodes[axes[0]])
        for axis in axes:
            self._hear_answer(axis, bytes(message.data))
        self._link.sort(message)  # whoever waits for it hears it, too

    def _hear_answer(self, axis: int, data: bytes) -> None:
        """An SDO answer of the node of an axis."""
        change = self._changes.get(axis)
        if axis in self.asking:
            self._hear_state(axis, data)
        if change is not None:
            change.answered(data, self._link.clock.now())
        elif len(data) == 8 and data[1:4] == self._mode_requests[axis][1:4] and data[0] & 0xE0 == 0x40:
            shown = int.from_bytes(data[4:5], "little", signed=True)
            wanted = self.operation[axis]
            enabled = state_of(self.sample.status[axis]) is DriveState.OPERATION_ENABLED
            if (
                wanted is not None and shown != int(wanted) and (shown or enabled)
            ):  # some drives show none until they are enabled
                name = self._config.axes[axis].name
                text = f"axis {name}: the drive left mode {wanted.name.lower()} for mode {shown} (0x6061)"
                self._link.events.append(Event(Severity.DRIVE, text, name))

    def _hear_state(self, axis: int, data: bytes) -> None:
        told = self._questions[axis].answered(data)
        if told is None:
            return
        what, value = told
        if what is od.STATUSWORD:
            self.sample.status[axis] = value
        else:
            self._counts[axis] = value
            self.sample.position[axis] = self.place_of(axis, value)
            self._told.add(axis)

    def _drain(self) -> None:
        """Take in all that waits before a SYNC: it is of an earlier one and would pass for this one's."""
        left = MOST_WAITING
        while (message := self._link.get(0)) is not None:
            left -= 1
            if left < 0:
                raise BusError(FLOODED)
            axis = self._tpdo_axis.get(message.arbitration_id)
            if axis is None:
                self._sort(message)
            elif self._owed[axis]:
                self._owed[axis] -= 1
                self.sample.late[axis] = True

    def _go_on_changing(self, now: float) -> None:
        """Conclude the changes of mode that are done or failed; send the next request of one of them."""
        for axis, change in list(self._changes.items()):
            if change.without_power and self.waits_for_power_off[axis]:
                continue
            why = change.failure(now)
            if why is not None:
                del self._changes[axis]
                name = self._config.axes[axis].name
                text = f"axis {name} (node {self._nodes[axis]}): {why}"
                self._link.events.append(Event(Severity.DRIVE, text, name))
            elif change.done:
                del self._changes[axis]
                self.operation[axis] = change.operation or self.operation[axis]
        if self._slot % EVERY_CYCLES:
            return
        waiting = list(self._changes)
        for k in range(len(waiting)):
            axis = waiting[(self._changes_asked + k) % len(waiting)]
            request = self._changes[axis].request(now, self._counts[axis])
            if request is not None and self._link.ask(self._nodes[axis], request):
                self._changes_asked += k + 1
                return

    def _watch_slowly(self, now: float) -> None:
        """Check heartbeats and the state of the bus; ask one axis after another for 0x6061."""
        self._next_mode_poll = now + MODE_POLL_S
        self._link.require_bus()
        limit = HEARTBEAT_PERIODS * self._config.safety.heartbeat_s
        for axis, peer in zip(self._config.axes, self._peers, strict=True):
            if peer.last_heartbeat is not None and now - peer.last_heartbeat > limit:
                self._link.events.append(
                    Event(
                        Severity.DRIVE,
                        f"axis {axis.name} (node {axis.node_id}): no heartbeat for "
                        f"{now - peer.last_heartbeat:.2f} s",
                        axis.name,
                    )
                )
        self._mode_asked = (self._mode_asked + 1) % len(self._nodes)
        self._link.ask(self._nodes[self._mode_asked], self._mode_requests[self._mode_asked])
