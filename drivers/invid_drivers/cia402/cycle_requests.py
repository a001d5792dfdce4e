"""What is asked of drives by SDO between two cycles: modes, single objects, states; nobody waits for it.

A drive may take a second for it (slow SDO, a slow mode switch). Nobody waits: torque of every axis in torque
mode goes on in its loop, that of the axis which changes too, whichever mode it is in by now.
"""

from __future__ import annotations

import struct

from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.objects import NodeAxis, Object
from invid_drivers.cia402.states import OperationMode

CHANGE_S = 3.0
"""Longest change of mode: three answers and a switch of 0.8 s, as slow drives take them, and one frame lost
and asked for again after a second."""
BUSY_S = 10.0
"""And where the drive says meanwhile that it is in no mode (0x6061 is 0 or -1): one report has 4 s."""
NOT_NOW = 0x08000022
"""SDO abort: not in the present state of the device."""
POLL_S = 0.005
"""Between two questions for 0x6061."""
EVERY_CYCLES = 2
"""One request on the bus in so many cycles: with its answer 27 % of a cycle at 1 kHz and 1 Mbit/s, of the
40 % that a budget of 80 % leaves in two."""


def download(what: Object, value: int) -> bytes:
    """Bytes of an expedited SDO write (CiA 301)."""
    data = what.pack(value)
    head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, what.index, what.sub)
    return (head + data).ljust(8, b"\0")


def upload(what: Object) -> bytes:
    """Bytes of an SDO read (CiA 301)."""
    return struct.pack("<BHB", 0x40, what.index, what.sub).ljust(8, b"\0")


class Change:
    """Objects written to a drive one after the other: a setting, which a drive may refuse, or another mode.

    A mode is asked for by 0x6060, with the place of an axis that is to be held as target before, and awaited
    in 0x6061.
    """

    def __init__(self, of_node: NodeAxis, steps: list[Object], value: int, began: float) -> None:
        """``value`` goes into each of ``steps`` that takes one."""
        self._at = of_node.at
        self._steps, self._value = steps, value
        self._began = self._next = began
        self.operation = OperationMode(value) if od.MODE_DISPLAY in steps else None
        """The mode that is asked for, if that is what changes."""
        self._shown: int | None = None
        self._refused: str | None = None
        self.without_power = False
        """It takes the mode without power only."""

    def ask_again(self, now: float) -> None:
        """Ask once more: the drive is without power by now."""
        self.without_power, self._refused, self._began = False, None, now

    @property
    def taken(self) -> bool:
        """Whether the drive has taken the mode, and may not show it yet."""
        return od.MODE not in self._steps

    @property
    def done(self) -> bool:
        """Whether the drive shows the mode, or has answered to the setting."""
        return not self._steps

    def request(self, now: float, counts: int) -> bytes | None:
        """The next request to send; ``None`` where none is due. ``counts``: where the axis is."""
        if self.done or now < self._next:
            return None
        step = self._steps[0]
        if step is od.MODE_DISPLAY:
            return upload(self._at(step))
        return download(self._at(step), counts if step is od.TARGET_POSITION else self._value)

    def answered(self, data: bytes, now: float) -> None:
        """Take in an SDO answer of the drive; one of another object is not for this change."""
        if self.done or len(data) != 8:
            return
        step = self._steps[0]
        named = data[1:4] == struct.pack("<HB", self._at(step).index, step.sub)
        if data[0] == 0x80 and (named or not any(data[1:4])):  # some drives abort without naming the object
            code = int.from_bytes(data[4:8], "little")
            self.without_power = step is od.MODE and code == NOT_NOW
            self._refused = f"{step.address} {step.name} was refused (SDO abort 0x{code:08X})"
            if self.operation is None:  # it keeps what it has
                self._steps.clear()
        elif named and step is od.MODE_DISPLAY and data[0] & 0xE0 == 0x40:
            self._shown = step.unpack(data[4:5])
            self._next = now + POLL_S
            if self._shown == self._value:
                self._steps.pop(0)
        elif named and data[0] & 0xE0 == 0x60:
            self._steps.pop(0)

    def failure(self, now: float) -> str | None:
        """Why the change will not come about; ``None`` while it may, or has."""
        if self.done:
            return None
        if self._refused is not None:
            why = self._refused
            if self.without_power:
                why += (
                    ": it takes one without power only, and the axis was not seen to stand without. Give it "
                    "a brake that its drive closes (brake: drive), unload it, or shake it in the mode that "
                    "holds it (in_closed_loop: true, by 0x60B2)"
                )
        elif now < self._began + (CHANGE_S if self._shown is None or self._shown > 0 else BUSY_S):
            return None
        elif self._shown is None:
            why = f"the drive does not answer ({self._steps[0].address}) for {CHANGE_S:g} s"
        else:
            why = f"the drive shows mode {self._shown} (0x6061) after {now - self._began:.0f} s"
        return (
            why if self.operation is None else f"mode {self.operation.name.lower()} was asked for, but {why}"
        )


class StateQuestion:
    """State and place of a drive whose process data do not come, or are not asked for."""

    def __init__(self, of_node: NodeAxis) -> None:
        self._next, self._at = od.STATUSWORD, of_node.at

    def request(self) -> bytes:
        """The next question: statusword and position by turns."""
        return upload(self._at(self._next))

    def answered(self, data: bytes) -> tuple[Object, int] | None:
        """The object that an answer tells and its value; ``None`` where it is another's."""
        if len(data) != 8 or data[0] & 0xE0 != 0x40:
            return None
        for what, other in ((od.STATUSWORD, od.POSITION), (od.POSITION, od.STATUSWORD)):
            if data[1:4] == struct.pack("<HB", self._at(what).index, what.sub):
                self._next = other
                return what, what.unpack(data[4 : 4 + what.size])
        return None
