"""Process data objects of a simulated node: mapping rules of CiA 301 and packed transfer."""

from __future__ import annotations

import struct
from collections.abc import Callable

from invid_drivers.simulated.object_dictionary import Entry, ObjectDictionary, SdoAbort

INVALID = 0x80000000


class ReceivePdo:
    """A PDO that the node receives; synchronous ones take effect at the next SYNC."""

    __slots__ = ("can_id", "due_ns", "entries", "event_ns", "number", "packing", "pending", "synchronous")

    def __init__(self, number: int, can_id: int, kind: int, entries: list[Entry], event_ns: int = 0) -> None:
        self.number, self.can_id, self.entries = number, can_id, entries
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

    __slots__ = (
        "can_id",
        "due",
        "entries",
        "event_ns",
        "inhibit_ns",
        "kind",
        "last",
        "number",
        "packing",
        "seen",
        "sent_ns",
    )

    def __init__(
        self, number: int, can_id: int, kind: int, entries: list[Entry], inhibit_ns: int, event_ns: int
    ) -> None:
        self.number, self.can_id, self.kind, self.entries = number, can_id, kind, entries
        self.packing = struct.Struct("<" + "".join(e.code for e in entries))
        self.inhibit_ns, self.event_ns = inhibit_ns, event_ns
        self.seen = 0
        self.last = b""
        self.sent_ns = -(1 << 62)

    def pack(self) -> bytes:
        """The data now."""
        return self.packing.pack(*[e.value for e in self.entries])


def mapped_entries(od: ObjectDictionary, index: int, way: str) -> list[Entry]:
    """Entries that mapping object ``index`` names; SdoAbort where one cannot be mapped."""
    entries: list[Entry] = []
    for sub in range(1, od.number(index) + 1):
        entries.append(_mapped(od, od.number(index, sub), way))
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

    ``changed`` is called after every accepted write. A drive that lacks the communication or the mapping has
    no such PDO.
    """
    if od.find(communication, 1) is None or od.find(mapping) is None:
        return
    cob, kind = od.entry(communication, 1), od.entry(communication, 2)

    def valid() -> bool:
        return not int(cob.value) & INVALID

    def write_cob(value: int) -> None:
        if valid() and not value & INVALID and (value ^ int(cob.value)) & 0x3FFFFFFF:
            raise SdoAbort(SdoAbort.RANGE)
        if not value & INVALID:
            if value & 0x20000000 or not 0x80 < value & 0x7FF < 0x700:
                raise SdoAbort(SdoAbort.RANGE)
            mapped_entries(od, mapping, way)
        cob.value = value
        changed()

    def write_kind(value: int) -> None:
        if 241 <= value <= 251 or (value in (252, 253) and way == "w"):
            raise SdoAbort(SdoAbort.RANGE)
        if value in (252, 253):  # remote requests are not answered
            raise SdoAbort(SdoAbort.RANGE)
        kind.value = value
        changed()

    def write_time(entry: Entry) -> Callable[[int], None]:
        def write(value: int) -> None:
            if entry.sub == 3 and valid():
                raise SdoAbort(SdoAbort.STATE)
            entry.value = value
            changed()

        return write

    count = od.entry(mapping, 0)

    def write_count(value: int) -> None:
        if valid():
            raise SdoAbort(SdoAbort.UNSUPPORTED)
        if value > 8:
            raise SdoAbort(SdoAbort.PDO_LENGTH)
        entries = [_mapped(od, od.number(mapping, sub), way) for sub in range(1, value + 1)]
        if sum(e.size for e in entries) > 8:
            raise SdoAbort(SdoAbort.PDO_LENGTH)

    def write_entry(value: int) -> None:
        if valid() or int(count.value) != 0:
            raise SdoAbort(SdoAbort.UNSUPPORTED)
        if value:
            _mapped(od, value, way)

    cob.on_write, kind.on_write, count.on_write = write_cob, write_kind, write_count
    for sub in (3, 5):
        entry = od.find(communication, sub)
        if entry is not None:
            entry.on_write = write_time(entry)
    for sub in range(1, 9):
        od.guard(mapping, sub, write_entry)
