"""The CiA 301 and CiA 402 objects that the service reads or writes, in one table, and where one of several
axes of a node has them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Object:
    """One object: address, ``struct`` code of its type, name for messages."""

    index: int
    sub: int
    code: str
    name: str

    @property
    def address(self) -> str:
        """``0x6071`` or ``0x607D:1``."""
        return f"0x{self.index:04X}" + (f":{self.sub}" if self.sub else "")

    @property
    def size(self) -> int:
        """Size of the value."""
        return struct.calcsize("<" + self.code)

    @property
    def mapping(self) -> int:
        """Entry of a PDO map: index, subindex, length in bits."""
        return self.index << 16 | self.sub << 8 | self.size * 8

    def pack(self, value: int) -> bytes:
        """Little-endian bytes; the value is clipped to the type, which a limit may exceed."""
        bits = self.size * 8
        low = -(1 << (bits - 1)) if self.code.islower() else 0
        high = (1 << (bits - 1)) - 1 if self.code.islower() else (1 << bits) - 1
        return struct.pack("<" + self.code, min(max(value, low), high))

    def unpack(self, data: bytes) -> int:
        """The value; a shorter answer than the type is extended, as some drives send it."""
        size = self.size
        if len(data) < size:
            negative = self.code.islower() and bool(data) and data[-1] & 0x80
            data = data + (b"\xff" if negative else b"\0") * (size - len(data))
        value: int = struct.unpack("<" + self.code, data[:size])[0]
        return value


DEVICE_TYPE = Object(0x1000, 0, "I", "device type")
SYNC_PERIOD = Object(0x1006, 0, "I", "communication cycle period")
SYNC_COUNTER = Object(0x1019, 0, "B", "synchronous counter overflow value")
CONSUMER_HEARTBEAT = Object(0x1016, 1, "I", "consumer heartbeat")
PRODUCER_HEARTBEAT = Object(0x1017, 0, "H", "producer heartbeat")
VENDOR_ID = Object(0x1018, 1, "I", "vendor id")
PRODUCT_CODE = Object(0x1018, 2, "I", "product code")
REVISION_NUMBER = Object(0x1018, 3, "I", "revision number")
SERIAL_NUMBER = Object(0x1018, 4, "I", "serial number")
ABORT_CONNECTION = Object(0x6007, 0, "h", "abort connection option")
ERROR_CODE = Object(0x603F, 0, "H", "error code")
CONSUMER_HEARTBEATS = Object(0x1016, 0, "B", "consumer heartbeats, their number")
CONTROLWORD = Object(0x6040, 0, "H", "controlword")
STATUSWORD = Object(0x6041, 0, "H", "statusword")
QUICK_STOP_OPTION = Object(0x605A, 0, "h", "quick stop option")
MODE = Object(0x6060, 0, "b", "mode of operation")
MODE_DISPLAY = Object(0x6061, 0, "b", "mode of operation display")
POSITION = Object(0x6064, 0, "i", "position actual value")
FOLLOWING_WINDOW = Object(0x6065, 0, "I", "following error window")
FOLLOWING_TIME = Object(0x6066, 0, "H", "following error time out")
TARGET_TORQUE = Object(0x6071, 0, "h", "target torque")
MAX_TORQUE = Object(0x6072, 0, "H", "max torque")
MAX_CURRENT = Object(0x6073, 0, "H", "max current")
RATED_CURRENT = Object(0x6075, 0, "I", "motor rated current")
RATED_TORQUE = Object(0x6076, 0, "I", "motor rated torque")
TORQUE = Object(0x6077, 0, "h", "torque actual value")
TARGET_POSITION = Object(0x607A, 0, "i", "target position")
RANGE_LOW = Object(0x607B, 1, "i", "position range limit, min")
RANGE_HIGH = Object(0x607B, 2, "i", "position range limit, max")
POSITION_LIMIT_LOW = Object(0x607D, 1, "i", "software position limit, min")
POSITION_LIMIT_HIGH = Object(0x607D, 2, "i", "software position limit, max")
MAX_VELOCITY = Object(0x607F, 0, "I", "max profile velocity")
MAX_MOTOR_SPEED = Object(0x6080, 0, "I", "max motor speed")
POLARITY = Object(0x607E, 0, "B", "polarity")
PROFILE_DECELERATION = Object(0x6084, 0, "I", "profile deceleration")
QUICK_STOP_DECELERATION = Object(0x6085, 0, "I", "quick stop deceleration")
ACCELERATION_NUMERATOR = Object(0x6097, 1, "I", "acceleration factor, numerator")
ACCELERATION_DIVISOR = Object(0x6097, 2, "I", "acceleration factor, divisor")
RPDO_EVENT_TIMER = Object(0x1400, 5, "H", "RPDO 1 event timer")
INHIBIT_TIME = Object(0x1800, 3, "H", "TPDO 1 inhibit time")
ENCODER_INCREMENTS = Object(0x608F, 1, "I", "position encoder resolution, increments")
ENCODER_REVOLUTIONS = Object(0x608F, 2, "I", "position encoder resolution, revolutions")
GEAR_MOTOR = Object(0x6091, 1, "I", "gear ratio, motor revolutions")
GEAR_SHAFT = Object(0x6091, 2, "I", "gear ratio, shaft revolutions")
FEED = Object(0x6092, 1, "I", "feed constant, feed")
FEED_REVOLUTIONS = Object(0x6092, 2, "I", "feed constant, shaft revolutions")
POSITION_NUMERATOR = Object(0x6093, 1, "I", "position factor, numerator")
POSITION_DIVISOR = Object(0x6093, 2, "I", "position factor, divisor")
VELOCITY_NUMERATOR = Object(0x6096, 1, "I", "velocity factor, numerator")
VELOCITY_DIVISOR = Object(0x6096, 2, "I", "velocity factor, divisor")
TORQUE_OFFSET = Object(0x60B2, 0, "h", "torque offset")
POSITION_OFFSET = Object(0x60B0, 0, "i", "position offset")
INTERPOLATION_VALUE = Object(0x60C2, 1, "B", "interpolation time, value")
INTERPOLATION_EXPONENT = Object(0x60C2, 2, "b", "interpolation time, power of ten")
POSITIVE_TORQUE_LIMIT = Object(0x60E0, 0, "H", "positive torque limit value")
NEGATIVE_TORQUE_LIMIT = Object(0x60E1, 0, "H", "negative torque limit value")
SUPPORTED_MODES = Object(0x6502, 0, "I", "supported drive modes")

KNOWN = {(o.index, o.sub): o for o in tuple(globals().values()) if isinstance(o, Object)}
"""Every object above by its address."""

RPDO_MAP = (CONTROLWORD, TARGET_TORQUE)
OFFSET_MAP = (CONTROLWORD, TORQUE_OFFSET)
"""RPDO of a drive that is shaken by its torque offset."""
TPDO_MAP = (POSITION, TORQUE, STATUSWORD)


_FIRST = {"RPDO": (0x1400, 0x1600), "TPDO": (0x1800, 0x1A00)}
"""Communication and mapping object of the first PDO of a kind."""


def pdo_communication(kind: str, number: int, sub: int) -> Object:
    """Communication object of a PDO, counted from 1."""
    index = _FIRST[kind][0] + number - 1
    return Object(index, sub, "I" if sub == 1 else "B", f"{kind} {number} communication")


def pdo_mapping(kind: str, number: int, sub: int) -> Object:
    """Mapping object of a PDO, counted from 1."""
    return Object(_FIRST[kind][1] + number - 1, sub, "I" if sub else "B", f"{kind} {number} mapping")


APART = 0x800
"""From an object of the profile to the same one of the next axis (CiA 402-1: 0x6000 to 0x67FF, 0x6800 …)."""
PDOS = 64
"""From a PDO of an axis to that of the next one (CiA 301, several logical devices)."""
COB_IDS = 0x100
"""From an identifier of the predefined set to the next PDO's, of which there are four."""


PDO_OBJECTS = frozenset({0x1400, 0x1600, 0x1800, 0x1A00})
"""Communication and mapping of the first PDO of either kind."""


@dataclass(frozen=True)
class NodeAxis:
    """One axis of a node, counted from 1, and the PDO that it exchanges in every cycle.

    What belongs to the node is all its axes': NMT state, heartbeat (0x1016, 0x1017), SYNC, emergencies,
    identity (0x1000, 0x1018) and the SDO channel. Objects below 0x6000 that a vendor keeps for each axis lie
    where he put them.
    """

    number: int = 1
    pdo: int = 1
    """Number of that PDO, of either kind, counted from 1."""

    @classmethod
    def by_profile(cls, number: int) -> NodeAxis:
        """The axis with the PDO that CiA 301 foresees for it."""
        return cls(number, 1 + PDOS * (number - 1))

    def at(self, what: Object) -> Object:
        """The same object of this axis; what is said of PDO 1 is said of its PDO."""
        if self.number == 1:
            return what
        if 0x6000 <= what.index < 0x6000 + APART:
            return replace(what, index=what.index + APART * (self.number - 1))
        return replace(what, index=what.index + self.pdo - 1) if what.index in PDO_OBJECTS else what

    def cob_id(self, kind: str, node_id: int) -> int:
        """Identifier of that "RPDO" or "TPDO"."""
        return {"RPDO": 0x200, "TPDO": 0x180}[kind] + COB_IDS * (self.number - 1) + node_id


def of_first_axis(index: int) -> tuple[int, int]:
    """Index of the same object of a node's first axis, and the axis that it belongs to."""
    if not 0x6000 <= index < 0xA000:
        return index, 1
    return 0x6000 + (index - 0x6000) % APART, 1 + (index - 0x6000) // APART
