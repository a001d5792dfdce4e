"""A node of CiA 301: NMT, SDO, PDO, SYNC, heartbeat; what it drives are its axes (`axis.py`)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .dictionary import (
    MISSING,
    NO_ACCESS,
    NO_SUB,
    NOT_MAPPED,
    PDOS,
    READ_ONLY,
    TOO_LONG,
    TOO_LOW,
    UNKNOWN_COMMAND,
    Entry,
    make_dictionary,
)  # fmt: skip

if TYPE_CHECKING:
    from .axis import Axis
    from .world import World

BOOT, OPERATIONAL, STOPPED, PRE_OPERATIONAL = 0x00, 0x05, 0x04, 0x7F
HEARTBEAT_LOST, RPDO_LATE, LEFT_OPERATIONAL = 0x8130, 0x8250, 0x8120


class Node:
    """One CANopen device."""

    def __init__(self, world: World, node: int, axes: int, spec: dict[str, Any]) -> None:
        self.world, self.node = world, node
        found = {int(at, 16): value for at, value in spec.get("found", {}).items()}
        self.od = make_dictionary(node, axes, found, {int(i, 16) for i in spec.get("lacks", ())})
        self.fresh = {at: e.value for at, e in self.od.items()}
        self.axes: list[Axis] = []
        self.sdo_s = float(spec.get("sdo_s", 0.0004))
        self.pdo_s = float(spec.get("pdo_s", 0.0001))
        self.event_s = float(spec.get("event_s", 0.0))
        """TPDO 1 comes at this period as well, whatever was asked of it [s]."""
        self.nmt = PRE_OPERATIONAL
        none = Entry("B", 0, False)
        self.beat, self.watch = (self.od.get(at, none) for at in (0x101700, 0x101601))
        self.timers = [
            tuple(self.od.get(at + (k << 8), none) for at in (0x140005, 0x180005, 0x180002))
            for k in range(PDOS)
        ]
        """Event timer of each RPDO, that of each TPDO and its type: looked at in every step."""
        self.listens = [
            tuple(self.od.get(at + (k << 8), none) for at in (0x140001, 0x140002)) for k in range(PDOS)
        ]
        """Identifier and type of each RPDO: looked at with every frame."""
        self.next_beat = 0.0
        self.heard: float | None = None
        self.boxes: dict[int, bytes] = {}
        self.got: dict[int, float] = {}
        self.sent: dict[int, float] = {}
        self.syncs = 0
        self.is_mute = False
        """It says nothing any more."""
        self.answers_sdo = True
        self.watches = True
        """Whether its heartbeat watch has an effect."""
        self.min_watch_s = 0.0
        """Its watch counts whole multiples of this [s]."""
        self.least = {int(at, 16): value for at, value in spec.get("least", {}).items()}
        """What it takes at least for an object, but zero."""

    # --- objects -----------------------------------------------------------------------------------
    def number(self, at: int, missing: int = 0) -> int:
        """A value as it stands in the dictionary."""
        entry = self.od.get(at)
        return missing if entry is None else entry.value

    def axis_of(self, index: int) -> tuple[Axis | None, int]:
        """The axis that an object belongs to, and the object's index at a first axis."""
        if 0x6000 <= index < 0xA000:
            k = (index - 0x6000) // 0x800
            if k < len(self.axes):
                return self.axes[k], index - 0x800 * k
        return None, index

    def read(self, at: int) -> int:
        """A value as the drive shows it."""
        axis, index = self.axis_of(at >> 8)
        return self.number(at) if axis is None else axis.shown(index << 8 | at & 0xFF, self.number(at))

    def store(self, at: int, value: int) -> int | None:
        """Write a value; the abort code where it is not taken."""
        entry = self.od[at]
        axis, index = self.axis_of(at >> 8)
        if axis is not None:
            refused = axis.refuses(index << 8 | at & 0xFF, value)
            if refused is not None:
                return refused or None
        entry.value = value
        if axis is not None:
            axis.written(index << 8 | at & 0xFF, value)
        return None

    # --- frames ------------------------------------------------------------------------------------
    def say(self, cob: int, data: bytes, after: float) -> None:
        """Send, unless the node has gone silent."""
        if not self.is_mute:
            self.world.from_node(self, cob, data, after)

    def hear(self, cob: int, data: bytes) -> None:
        """One frame of the bus."""
        now = self.world.now
        if cob == 0x80:
            if self.nmt == OPERATIONAL and bool(data) == bool(self.number(0x101900)):
                self.sync(now)
        elif cob == 0:
            if len(data) == 2 and data[1] in (0, self.node):
                self.command_nmt(data[0])
        elif cob == 0x600 + self.node:
            if self.nmt != STOPPED and self.answers_sdo and len(data) == 8:
                answer = self.sdo(data)
                if answer:
                    self.say(0x580 + self.node, answer, self.sdo_s)
        elif cob & 0x780 == 0x700:
            if cob & 0x7F == self.number(0x101601) >> 16 & 0x7F and self.number(0x101601) & 0xFFFF:
                self.heard = now
        elif self.nmt == OPERATIONAL:
            for k, (identifier, kind) in enumerate(self.listens):
                if cob == identifier.value:
                    self.boxes[k] = data
                    self.got[k] = now
                    if kind.value > 240:
                        self.take(k)

    def command_nmt(self, command: int) -> None:
        """NMT command of the master."""
        after = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}.get(command)
        if command in (0x81, 0x82):
            self.restart()
        elif after is not None and after != self.nmt:
            self.world.note(self.node, f"NMT {self.nmt} to {after}")
            left = self.nmt == OPERATIONAL
            self.nmt = after
            self.boxes.clear()
            self.got.clear()
            if left:
                for axis in self.axes:
                    axis.left_operational()

    def restart(self) -> None:
        """Power cycle or NMT reset: as it was commissioned, pre-operational."""
        for axis in self.axes:
            axis.boot()
        for at, value in self.fresh.items():
            self.od[at].value = value
        self.nmt, self.heard = PRE_OPERATIONAL, None
        self.boxes.clear()
        self.got.clear()
        self.say(0x700 + self.node, b"\0", 0.15)

    def sync(self, now: float) -> None:
        """Synchronous PDOs: what came is taken, what is asked for is sent."""
        self.syncs += 1
        for k in range(PDOS):
            if self.number(0x140002 + (k << 8)) <= 240:
                self.take(k)
            kind = self.number(0x180002 + (k << 8))
            if 0 < kind <= 240 and self.syncs % kind == 0:
                self.publish(k, now)

    def take(self, k: int) -> None:
        """What an RPDO brought."""
        data, at = self.boxes.pop(k, None), 0
        if data is None:
            return
        for n in range(1, self.number(0x160000 + (k << 8)) + 1):
            mapped = self.number(0x160000 + (k << 8) | n)
            size = (mapped & 0xFF) // 8
            entry = self.od.get(mapped >> 8)
            if entry is not None and at + size <= len(data):
                self.store(mapped >> 8, entry.unpack(data[at : at + size]))
            at += size

    def publish(self, k: int, now: float) -> None:
        """A TPDO, unless it is off or inhibited."""
        if self.number(0x180001 + (k << 8)) >> 31 or not self.number(0x1A0000 + (k << 8)):
            return
        if now - self.sent.get(k, -1.0) < self.number(0x180003 + (k << 8)) * 1e-4 - 1e-9:
            return
        self.sent[k] = now
        data = b""
        for n in range(1, self.number(0x1A0000 + (k << 8)) + 1):
            at = self.number(0x1A0000 + (k << 8) | n) >> 8
            data += self.od[at].pack(self.read(at))
        self.say(self.number(0x180001 + (k << 8)) & 0x7FF, data, self.pdo_s)

    def sdo(self, data: bytes) -> bytes:
        """Answer of the SDO server: expedited transfers."""
        head, index, sub = struct.unpack_from("<BHB", data)
        at = index << 8 | sub
        entry = self.od.get(at)
        axis, own = self.axis_of(index)
        if head == 0x80:
            return b""
        code: int | None = None
        if entry is None:
            code = NO_SUB if any(a >> 8 == index for a in self.od) else MISSING
        if axis is not None and code is None:
            code = axis.disturbed(own << 8 | sub, is_write=head >> 5 == 1)
        if code is None and entry is not None:
            if head >> 5 == 2:
                body = entry.pack(self.read(at)).ljust(4, b"\0")
                return bytes((0x43 | 4 - entry.size << 2, *data[1:4])) + body
            code = self._download(data, at) if head >> 5 == 1 and head & 2 else UNKNOWN_COMMAND
            if code is None:
                return bytes((0x60, *data[1:4], 0, 0, 0, 0))
        return struct.pack("<BHBI", 0x80, index, sub, code)

    def _download(self, data: bytes, at: int) -> int | None:
        entry, index, sub = self.od[at], at >> 8, at & 0xFF
        size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else entry.size
        if size != entry.size:
            return TOO_LONG
        if not entry.writable:
            return READ_ONLY
        value = entry.unpack(data[4 : 4 + size])
        if 0 < value < self.least.get(at, 0):
            return TOO_LOW
        if index & 0xFA00 in (0x1600, 0x1A00) and 0x1600 <= index < 0x1C00:
            if not self.number((index - 0x200 << 8) | 1) >> 31 or (sub and self.number(index << 8)):
                return NO_ACCESS
            if sub and value and value >> 8 not in self.od:
                return NOT_MAPPED
        return self.store(at, value)

    # --- time --------------------------------------------------------------------------------------
    def tick(self, now: float) -> None:
        """Timers, every step of the plant."""
        beat = self.beat.value
        if beat and now >= self.next_beat:
            self.next_beat = now + beat / 1000
            self.say(0x700 + self.node, bytes((self.nmt,)), 1e-4)
        watch = (self.watch.value & 0xFFFF) / 1000
        if self.heard is not None and watch and self.watches:
            if self.min_watch_s:
                watch = self.min_watch_s * -(-watch // self.min_watch_s)
            if now - self.heard > watch:
                self.heard = None
                self.for_all(lambda axis: axis.connection_lost(HEARTBEAT_LOST))
        if self.nmt != OPERATIONAL:
            return
        if self.event_s and now - self.sent.get(0, -1.0) >= self.event_s:
            self.publish(0, now)
        for k, (limit, period, kind) in enumerate(self.timers):
            if limit.value and k in self.got and now - self.got[k] > limit.value / 1000:
                del self.got[k]
                self.for_all(lambda axis: axis.connection_lost(RPDO_LATE))
            if period.value and kind.value > 240 and now - self.sent.get(k, -1.0) >= period.value / 1000:
                self.publish(k, now)

    def for_all(self, what: Callable[[Axis], None]) -> None:
        """Do something to every axis."""
        for axis in self.axes:
            what(axis)

    def emergency(self, code: int) -> None:
        """EMCY object."""
        self.say(0x80 + self.node, struct.pack("<HB5x", code, 0x11), 1e-4)
