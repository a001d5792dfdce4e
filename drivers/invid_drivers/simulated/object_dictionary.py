"""The object dictionary of a simulated CiA 402 drive."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from canopen.sdo.exceptions import SdoAbortedError

from invid_drivers.simulated.vendors import Profile

# data types of CiA 301 that are used: struct code and size in bytes ("s": visible string)
_SIZES = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4}


class SdoAbort(SdoAbortedError):
    """An SDO access that is refused, with CiA 301's abort code."""

    COMMAND = 0x05040001
    UNSUPPORTED = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    RANGE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    STATE = 0x08000022


class Entry:
    """One value of the dictionary: type, access, limits, and what happens when it is written."""

    __slots__ = (
        "access", "code", "default", "high", "index", "low", "mappable", "on_write", "size", "sub", "value",
        "written",
    )  # fmt: skip

    def __init__(
        self, index: int, sub: int, code: str, access: str, value: int | str, mappable: str = ""
    ) -> None:
        self.index, self.sub, self.code, self.access = index, sub, code, access
        self.value: int | str = value
        self.default = value
        self.mappable = mappable
        """"r": may be sent in a TPDO, "w": may be received in an RPDO."""
        self.size = _SIZES.get(code, 0)
        bits = 8 * self.size or 8  # a string has no limits of its own
        self.low = -(1 << (bits - 1)) if code.islower() else 0
        self.high = (1 << (bits - 1)) - 1 if code.islower() else (1 << bits) - 1
        self.on_write: Callable[[int], None] | None = None
        """Called before a value is stored; raises SdoAbort to refuse."""
        self.written: Callable[[], None] = lambda: None
        """Called when a value has been stored."""

    def encode(self) -> bytes:
        """Bytes of the value as they go over the bus."""
        if isinstance(self.value, str):
            return self.value.encode("ascii", "replace")
        return struct.pack("<" + self.code, self.value)

    def read(self) -> bytes:
        """Bytes that an SDO upload gets."""
        if self.access == "wo":
            raise SdoAbort(SdoAbort.WRITE_ONLY)
        return self.encode()

    def require_writable(self) -> None:
        """Refuse what cannot be written."""
        if self.access in ("ro", "const"):
            raise SdoAbort(SdoAbort.READ_ONLY)

    def write(self, data: bytes) -> None:
        """Store what an SDO download brings, or refuse it."""
        self.require_writable()
        if len(data) != self.size:
            raise SdoAbort(SdoAbort.TOO_LONG if len(data) > self.size else SdoAbort.TOO_SHORT)
        value: int = struct.unpack("<" + self.code, data)[0]
        if value > self.high:
            raise SdoAbort(SdoAbort.TOO_HIGH)
        if value < self.low:
            raise SdoAbort(SdoAbort.TOO_LOW)
        if self.on_write is not None:
            self.on_write(value)
        self.value = value
        self.written()


class ObjectDictionary:
    """Entries by index and subindex."""

    def __init__(self) -> None:
        self._entries: dict[int, dict[int, Entry]] = {}

    def add(
        self, index: int, sub: int, code: str, access: str, value: int | str = 0, mappable: str = ""
    ) -> Entry:
        """Add an entry and return it."""
        entry = Entry(index, sub, code, access, value, mappable)
        self._entries.setdefault(index, {})[sub] = entry
        return entry

    def entry(self, index: int, sub: int = 0) -> Entry:
        """The entry, or the abort code that tells which of the two does not exist."""
        subs = self._entries.get(index)
        if subs is None:
            raise SdoAbort(SdoAbort.NO_OBJECT)
        entry = subs.get(sub)
        if entry is None:
            raise SdoAbort(SdoAbort.NO_SUBINDEX)
        return entry

    def find(self, index: int, sub: int = 0) -> Entry | None:
        """The entry, None where the drive lacks it."""
        return self._entries.get(index, {}).get(sub)

    def preset(self, values: Mapping[tuple[int, int], int | str]) -> None:
        """Let objects that the drive has come with these values."""
        for (index, sub), value in values.items():
            entry = self.find(index, sub)
            if entry is not None:
                entry.value = entry.default = value

    def number(self, index: int, sub: int = 0, missing: int = 0) -> int:
        """An integer value; ``missing`` where the drive lacks the object."""
        entry = self._entries.get(index, {}).get(sub)
        return missing if entry is None or isinstance(entry.value, str) else entry.value

    def put(self, index: int, sub: int, value: int) -> None:
        """Set a value by the drive's own doing, where it has the object."""
        entry = self.find(index, sub)
        if entry is not None:
            entry.value = value

    def guard(
        self,
        index: int,
        sub: int,
        on_write: Callable[[int], None] | None,
        written: Callable[[], None] = lambda: None,
    ) -> None:
        """Set what a write does before and after the value is stored, where the drive has the object."""
        entry = self.find(index, sub)
        if entry is not None:
            entry.on_write, entry.written = on_write, written

    def remove(self, index: int) -> None:
        """Take an object away, as a vendor did."""
        self._entries.pop(index, None)

    def remove_entry(self, index: int, sub: int) -> None:
        """Take one subindex away, and the object with its last."""
        subs = self._entries.get(index, {})
        subs.pop(sub, None)
        if not subs:
            self._entries.pop(index, None)

    def __iter__(self) -> Iterator[Entry]:
        for subs in self._entries.values():
            yield from subs.values()


@dataclass(frozen=True)
class Nameplate:
    """Drive and motor of an axis: name, serial number and what they are made for."""

    name: str
    serial: int
    rated_torque: float
    """[N·m or N]; goes into 0x6076 in thousandths."""
    encoder_counts: float
    """Per revolution or metre; goes into 0x608F."""


Row = tuple[int, int, str, str, int | str, str]
"""Index, subindex, type, access, value, and in which PDOs it may be mapped."""


def _record(index: int, *subs: tuple[str, str, int]) -> list[Row]:
    """Sub 0 with the highest subindex, then one row per (type, access, value)."""
    numbered = [(index, n, code, access, value, "") for n, (code, access, value) in enumerate(subs, 1)]
    return [(index, 0, "B", "const", len(subs), ""), *numbered]


_ROWS: tuple[Row, ...] = (
    (0x1000, 0, "I", "ro", 0x00020192, ""),  # servo drive, CiA 402
    (0x1001, 0, "B", "ro", 0, "r"),
    (0x1003, 0, "B", "rw", 0, ""),
    *((0x1003, sub, "I", "ro", 0, "") for sub in range(1, 9)),
    (0x1005, 0, "I", "rw", 0x80, ""),
    (0x1006, 0, "I", "rw", 0, ""),
    (0x1007, 0, "I", "rw", 0, ""),
    (0x1008, 0, "s", "const", "", ""),
    (0x1009, 0, "s", "const", "1.0", ""),
    (0x100A, 0, "s", "const", "invid simulated drive", ""),
    (0x1014, 0, "I", "rw", 0, ""),
    (0x1015, 0, "H", "rw", 0, ""),
    *_record(0x1016, *[("I", "rw", 0)] * 3),
    (0x1017, 0, "H", "rw", 0, ""),
    *_record(0x1018, *[("I", "ro", v) for v in (0, 0x402, 1, 0)]),
    *_record(0x1029, ("B", "rw", 0)),
    *_record(0x1200, ("I", "ro", 0), ("I", "ro", 0)),
    # CiA 301: dummies to fill a receive PDO
    *((index, 0, code, "wo", 0, "w") for index, code in enumerate("bhiBHI", 2)),
    *_record(0x3001, ("I", "ro", 3000), ("I", "rw", 5000)),  # a vendor's area: current limits in mA
    (0x6007, 0, "h", "rw", 1, ""),
    (0x603F, 0, "H", "ro", 0, "r"),
    (0x6040, 0, "H", "rw", 0, "rw"),
    (0x6041, 0, "H", "ro", 0, "r"),
    (0x605A, 0, "h", "rw", 2, ""),
    (0x605B, 0, "h", "rw", 0, ""),
    (0x605C, 0, "h", "rw", 1, ""),
    (0x605D, 0, "h", "rw", 1, ""),
    (0x605E, 0, "h", "rw", 2, ""),
    (0x6060, 0, "b", "rw", 0, "rw"),
    (0x6061, 0, "b", "ro", 0, "r"),
    (0x6062, 0, "i", "ro", 0, "r"),
    (0x6064, 0, "i", "ro", 0, "r"),
    (0x6065, 0, "I", "rw", 0xFFFFFFFF, ""),
    (0x6066, 0, "H", "rw", 0, ""),
    (0x606C, 0, "i", "ro", 0, "r"),
    (0x6071, 0, "h", "rw", 0, "rw"),
    (0x6072, 0, "H", "rw", 3000, "rw"),
    (0x6073, 0, "H", "rw", 3000, ""),
    (0x6074, 0, "h", "ro", 0, "r"),
    (0x6075, 0, "I", "rw", 3000, ""),  # as the vendor's area says
    (0x6076, 0, "I", "rw", 0, ""),
    (0x6077, 0, "h", "ro", 0, "r"),
    (0x6078, 0, "h", "ro", 0, "r"),
    (0x607A, 0, "i", "rw", 0, "rw"),
    (0x607C, 0, "i", "rw", 0, ""),
    *_record(0x607D, ("i", "rw", -(1 << 31)), ("i", "rw", (1 << 31) - 1)),
    (0x607F, 0, "I", "rw", 0xFFFFFFFF, ""),
    (0x6080, 0, "I", "rw", 0xFFFFFFFF, ""),
    (0x6084, 0, "I", "rw", 0, ""),
    (0x6085, 0, "I", "rw", 0, ""),
    (0x6087, 0, "I", "rw", 1000, ""),
    *_record(0x608F, ("I", "rw", 1), ("I", "rw", 1)),
    *_record(0x6091, ("I", "rw", 1), ("I", "rw", 1)),
    *_record(0x6092, ("I", "rw", 1), ("I", "rw", 1)),
    (0x60B2, 0, "h", "rw", 0, "rw"),
    *_record(0x60C2, ("B", "rw", 1), ("b", "rw", -3)),
    (0x60F4, 0, "i", "ro", 0, "r"),
    (0x60FD, 0, "I", "ro", 0, "r"),
    (0x60FF, 0, "i", "rw", 0, "rw"),
    # torque profile, cyclic synchronous position, cyclic synchronous torque
    (0x6502, 0, "I", "ro", (1 << 3) | (1 << 7) | (1 << 9), ""),
)
"""The generic drive; what is its own stands in ``_own_values``. Velocities are in counts per second."""
_RECEIVED = {1: [0x60400010], 2: [0x60400010, 0x60600008], 3: [0x60400010, 0x60710010], 4: [0x607A0020]}
_SENT = {1: [0x60410010], 2: [0x60410010, 0x60610008], 3: [0x60410010, 0x60640020], 4: [0x606C0020]}
"""What the first PDOs map: index, subindex, bits."""


def drive_dictionary(
    node_id: int, plate: Nameplate, profile: Profile, ramps: tuple[int, int]
) -> ObjectDictionary:
    """The object dictionary of the generic drive with one vendor's departures applied.

    ``ramps``: 0x6084 and 0x6085 as the drive counts them.
    """
    od = ObjectDictionary()
    received = _pdo_rows(node_id, 0x1400, 0x200, profile.rpdos, _RECEIVED)
    sent = _pdo_rows(node_id, 0x1800, 0x180, profile.tpdos, _SENT)
    for row in (*_ROWS, *received, *sent):
        od.add(*row)
    od.preset(_own_values(node_id, plate, ramps))
    for index in profile.lacks:
        od.remove(index)
    od.preset(profile.values)
    return od


def _own_values(node_id: int, plate: Nameplate, ramps: tuple[int, int]) -> dict[tuple[int, int], int | str]:
    counts = max(1, round(plate.encoder_counts))
    return {
        (0x1008, 0): plate.name,
        (0x1014, 0): 0x80 + node_id,
        (0x1018, 4): plate.serial,
        (0x1200, 1): 0x600 + node_id,
        (0x1200, 2): 0x580 + node_id,
        (0x6076, 0): max(1, round(plate.rated_torque * 1000.0)),
        (0x6084, 0): ramps[0],
        (0x6085, 0): ramps[1],
        (0x608F, 1): counts,
        (0x6092, 1): counts,
    }


def _pdo_rows(
    node_id: int, first: int, can_id: int, count: int, maps: Mapping[int, list[int]]
) -> Iterator[Row]:
    """Communication and mapping objects of so many PDOs of a kind; the first four have identifiers, the first
    alone is valid."""
    for n in range(count):
        cob = can_id + 0x100 * n + node_id if n < 4 else 0x80000000
        yield (first + n, 0, "B", "const", 5, "")
        yield (first + n, 1, "I", "rw", cob | (0x80000000 if n else 0), "")
        yield from ((first + n, sub, code, "rw", value, "") for sub, code, value in _PDO_TIMES)
        mapped = maps.get(n + 1, [])
        mapping = first + 0x200 + n
        yield (mapping, 0, "B", "rw", len(mapped), "")
        yield from ((mapping, k + 1, "I", "rw", v, "") for k, v in enumerate((mapped + 8 * [0])[:8]))


_PDO_TIMES = ((2, "B", 255), (3, "H", 0), (5, "H", 0))
"""Transmission type, inhibit time and event timer of a communication object."""
