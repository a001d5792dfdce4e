"""Process data objects of a simulated node: mapping rules of CiA 301 and packed transfer."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from invid_drivers.simulated.object_dictionary import Entry, ObjectDictionary, SdoAbort

INVALID, NO_RTR = 0x80000000, 0x40000000


class ReceivePdo:
    """A PDO that the node receives; synchronous ones take effect at the next SYNC."""

    __slots__ = ("can_id", "due_ns", "entries", "event_ns", "packing", "pending", "synchronous")

    def __init__(self, can_id: int, kind: int, entries: list[Entry], event_ns: int) -> None:
        self.can_id, self.entries = can_id, entries
        self.event_ns = event_ns
        """Longest time to the next one, by sub 5 of its communication object; 0: any."""
        self.due_ns: int | None = None
        self.synchronous = kind <= 240
        self.packing = struct.Struct("<" + "".join(e.code for e in entries))
        self.pending: bytes | None = None

    def apply(self, data: bytes) -> None:
        """Write the mapped values."""
        for entry, value in zip(self.entries, self.packing.unpack_from(data)):  # noqa: B905 - hot
            entry.value = value


class TransmitPdo:
    """A PDO that the node sends."""

    __slots__ = ("can_id", "entries", "event_ns", "inhibit_ns", "kind", "last", "packing", "seen", "sent_ns")

    def __init__(self, can_id: int, kind: int, entries: list[Entry], inhibit_ns: int, event_ns: int) -> None:
        self.can_id, self.kind, self.entries = can_id, kind, entries
        self.packing = struct.Struct("<" + "".join(e.code for e in entries))
        self.inhibit_ns, self.event_ns = inhibit_ns, event_ns
        self.seen = 0
        self.last = b""
        self.sent_ns = -(1 << 62)

    def pack(self) -> bytes:
        """The data to send now."""
        return self.packing.pack(*[e.value for e in self.entries])


def mapped_entries(od: ObjectDictionary, index: int, way: str, count: int | None = None) -> list[Entry]:
    """Entries that mapping object ``index`` names, or the first ``count``; SdoAbort where one cannot be
    mapped."""
    last = od.number(index) if count is None else count
    entries = [_mapped(od, od.number(index, sub), way) for sub in range(1, last + 1)]
    if sum(e.size for e in entries) > 8:
        raise SdoAbort(SdoAbort.PDO_LENGTH)
    return entries


def _mapped(od: ObjectDictionary, value: int, way: str) -> Entry:
    entry = od.find(value >> 16, (value >> 8) & 0xFF)
    if entry is None:
        raise SdoAbort(SdoAbort.NO_OBJECT)
    if way not in entry.mappable or value & 0xFF != 8 * entry.size:
        raise SdoAbort(SdoAbort.NOT_MAPPABLE)
    return entry


def guard_configuration(
    od: ObjectDictionary, *, communication: int, mapping: int, way: str, changed: Callable[[], None]
) -> None:
    """Let writes follow CiA 301: invalidate, sub 0 to zero, map, count, validate.

    ``changed`` is called after every accepted write to the communication object. A drive that lacks it or the
    mapping has no such PDO.
    """
    if od.find(communication, 1) is None or od.find(mapping) is None:
        return
    guard = _ConfigurationGuard(od, communication, mapping, way)
    for sub, check in ((1, guard.check_cob), (2, guard.check_kind), (3, guard.check_inhibit), (5, None)):
        od.guard(communication, sub, check, changed)
    od.guard(mapping, 0, guard.check_count)
    for sub in range(1, 9):
        od.guard(mapping, sub, guard.check_mapped)


@dataclass(frozen=True)
class _ConfigurationGuard:
    """What may be written to the communication and mapping objects of one PDO, and when."""

    od: ObjectDictionary
    communication: int
    mapping: int
    way: str

    def _is_valid(self) -> bool:
        return not int(self.od.entry(self.communication, 1).value) & INVALID

    def check_cob(self, value: int) -> None:
        cob = self.od.entry(self.communication, 1)
        if not value & INVALID:
            if self._is_valid() and (value ^ int(cob.value)) & 0x3FFFFFFF:
                raise SdoAbort(SdoAbort.RANGE)
            if int(cob.value) & NO_RTR and not value & NO_RTR:
                raise SdoAbort(SdoAbort.RANGE)  # it answers no remote requests, and says so
            if value & 0x20000000 or not 0x80 < value & 0x7FF < 0x700:
                raise SdoAbort(SdoAbort.RANGE)
            mapped_entries(self.od, self.mapping, self.way)

    def check_kind(self, value: int) -> None:
        if 241 <= value <= 253:  # reserved; 252 and 253: remote requests, which are not answered
            raise SdoAbort(SdoAbort.RANGE)

    def check_inhibit(self, value: int) -> None:
        if self._is_valid():
            raise SdoAbort(SdoAbort.STATE)

    def check_count(self, value: int) -> None:
        if self._is_valid():
            raise SdoAbort(SdoAbort.UNSUPPORTED)
        if value > 8:
            raise SdoAbort(SdoAbort.PDO_LENGTH)
        mapped_entries(self.od, self.mapping, self.way, value)

    def check_mapped(self, value: int) -> None:
        if self._is_valid() or int(self.od.entry(self.mapping, 0).value) != 0:
            raise SdoAbort(SdoAbort.UNSUPPORTED)
        if value:
            _mapped(self.od, value, self.way)
