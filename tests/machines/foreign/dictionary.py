"""The object dictionary of a node with so many axes, typed from CiA 301 and 402-2."""

import math
import struct
from dataclasses import dataclass

BITS = 16
PER_RAD = (1 << BITS) / (2 * math.pi)
RATED = 50.0
"""Rated torque of every drive [N·m]: a thousandth is 0.05 N·m."""
NONE = 0xFFFFFFFF
MISSING, NO_SUB, READ_ONLY, TOO_LONG, TOO_LOW = 0x06020000, 0x06090011, 0x06010002, 0x06070010, 0x06090032
UNKNOWN_COMMAND, NOT_MAPPED, NOT_NOW, NO_ACCESS = 0x05040001, 0x06040041, 0x08000022, 0x06010000

COMMUNICATION = {
    # index << 8 | sub: struct code, value, 1 where it can be written
    0x100000: ("I", 0x00020192, 0), 0x100100: ("B", 0, 0), 0x100500: ("I", 0x80, 1),
    0x100600: ("I", 0, 1), 0x101600: ("B", 1, 0), 0x101601: ("I", 0, 1), 0x101700: ("H", 0, 1),
    0x101800: ("B", 4, 0), 0x101801: ("I", 0x0000C0DE, 0), 0x101802: ("I", 0x0402, 0),
    0x101803: ("I", 1, 0), 0x101804: ("I", 0, 0),
}  # fmt: skip
PROFILE = {
    0x600700: ("h", 1, 1), 0x603F00: ("H", 0, 0), 0x604000: ("H", 0, 1), 0x604100: ("H", 0x40, 0),
    0x605A00: ("h", 2, 1), 0x605B00: ("h", 0, 1), 0x605C00: ("h", 1, 1), 0x605E00: ("h", 2, 1),
    0x606000: ("b", 0, 1), 0x606100: ("b", 0, 0), 0x606400: ("i", 0, 0),
    0x606500: ("I", NONE, 1), 0x606600: ("H", 0, 1), 0x607100: ("h", 0, 1), 0x607200: ("H", 2000, 1),
    0x607600: ("I", round(1000 * RATED), 0), 0x607700: ("h", 0, 0), 0x607A00: ("i", 0, 1),
    0x607D00: ("B", 2, 0), 0x607D01: ("i", -(1 << 31), 1), 0x607D02: ("i", (1 << 31) - 1, 1),
    0x607F00: ("I", 10**6, 1), 0x608400: ("I", round(10 * PER_RAD), 1),
    0x608500: ("I", round(20 * PER_RAD), 1), 0x608F00: ("B", 2, 0), 0x608F01: ("I", 1 << BITS, 0),
    0x608F02: ("I", 1, 0), 0x650200: ("I", 1 << 7 | 1 << 9, 0),
}  # fmt: skip
OPTIONAL = {  # there only where a drive has them
    0x101900: ("B", 0, 1), 0x607B01: ("i", 0, 1), 0x607B02: ("i", 0, 1), 0x607C00: ("i", 0, 1),
    0x607E00: ("B", 0, 1), 0x608000: ("I", NONE, 1), 0x609101: ("I", 1, 1), 0x609102: ("I", 1, 1),
    0x609201: ("I", 1, 1), 0x609202: ("I", 1, 1), 0x609301: ("I", 1, 1), 0x609302: ("I", 1, 1),
    0x609601: ("I", 1, 1), 0x609602: ("I", 1, 1), 0x60B000: ("i", 0, 1), 0x60B200: ("h", 0, 1),
    0x60E000: ("H", 0, 1), 0x60E100: ("H", 0, 1), 0x607300: ("H", 0, 1), 0x607500: ("I", 0, 1),
}  # fmt: skip
PDOS = 4
AXIS = 0x800
"""From an axis of a node to the next (CiA 402-2, 5.3)."""


@dataclass
class Entry:
    """One object."""

    code: str
    value: int
    writable: bool

    @property
    def size(self) -> int:
        """Its length in bytes."""
        return struct.calcsize("<" + self.code)

    def pack(self, value: int) -> bytes:
        """A value as it goes over the bus."""
        bits = 8 * self.size
        return (value & (1 << bits) - 1).to_bytes(self.size, "little")

    def unpack(self, data: bytes) -> int:
        """A value as it came over the bus."""
        return int(struct.unpack("<" + self.code, data)[0])


def make_dictionary(node: int, axes: int, found: dict[int, int], lacks: set[int]) -> dict[int, Entry]:
    """Every object of a node; ``found``: what it was commissioned with, ``lacks``: indices, or addresses."""
    raw: dict[int, tuple[str, int, int]] = dict(COMMUNICATION)
    raw[0x101804] = ("I", 5000 + node, 0)
    for number in range(PDOS):
        off = 0 if number < axes else 1
        for first, own in ((0x1400, 0x200), (0x1800, 0x180)):
            at = first + number << 8
            raw[at] = ("B", 5, 0)
            raw[at | 1] = ("I", off << 31 | own + 0x100 * number + node, 1)
            raw[at | 2] = ("B", 255, 1)
            raw[at | 5] = ("H", 0, 1)
            if first == 0x1800:
                raw[at | 3] = ("H", 0, 1)
            for sub in range(5):
                raw[(first + 0x200 + number << 8) | sub] = ("I" if sub else "B", 0, 1)
    for axis in range(axes):
        raw |= {at + (AXIS * axis << 8): entry for at, entry in PROFILE.items()}
    for at, value in found.items():
        code, _, writable = raw[at] if at in raw else OPTIONAL[at if at < 0x680000 else at - (AXIS << 8)]
        raw[at] = (code, value, writable)
    return {at: Entry(c, v, bool(w)) for at, (c, v, w) in raw.items() if not {at, at >> 8} & lacks}
