"""Objects of one drive over SDO: read, found or missing, and written with the journal first."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

from invid.config import AxisConfig
from invid.errors import DriveError
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.journal import Entry, Journal
from invid_drivers.cia402.link import Link, SdoAbortedError, SdoCommunicationError, SdoError
from invid_drivers.cia402.objects import NodeAxis, Object, of_first_axis
from invid_drivers.cia402.stated.declared import declared_of
from invid_drivers.cia402.stated.vendors import VENDORS

PROTECTION = (
    od.CONSUMER_HEARTBEATS, od.CONSUMER_HEARTBEAT, od.PRODUCER_HEARTBEAT, od.ABORT_CONNECTION,
    od.QUICK_STOP_OPTION, od.POSITIVE_TORQUE_LIMIT, od.NEGATIVE_TORQUE_LIMIT,
    od.MAX_TORQUE, od.MAX_CURRENT, od.POSITION_LIMIT_LOW, od.POSITION_LIMIT_HIGH,
    od.MAX_VELOCITY, od.MAX_MOTOR_SPEED, od.FOLLOWING_WINDOW, od.FOLLOWING_TIME,
)  # fmt: skip
"""What keeps an axis from doing harm by itself: asked for whatever an EDS says."""
MISSING = frozenset({0x06020000, 0x06090011, 0x06010001})
"""SDO aborts of a read that say that there is nothing to read: no object, no subindex, write-only."""
AGAIN_S = 0.02
"""Before a drive is asked again that could not answer a question at the moment."""
READ_ONLY = frozenset({0x06010000, 0x06010002, 0x08000020, 0x08000021})
"""SDO aborts that mean that an object is not to be written at all, whatever the value."""


ABORTS = {
    0x06020000: "the object does not exist",
    0x06090011: "the subindex does not exist",
    0x06010002: "it is read-only",
    0x06010001: "it is write-only",
    0x06040041: "it cannot be mapped into a PDO",
    0x06040042: "the PDO would be too long",
    0x06090030: "the value is out of range",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x08000022: "not in the drive's present state",
}


class ObjectError(DriveError):
    """A drive failed at one object."""

    node_id: int
    what: Object
    abort: int | None
    """SDO abort code, where the drive sent one."""
    said: str
    """The text without axis and node."""
    says_node = False
    """Whether ``said`` names the node itself."""

    @classmethod
    def at(cls, axis: str, node_id: int, what: Object, said: str, abort: int | None = None) -> Self:
        """The failure of one axis's drive; built here, for an error must be made again from its text."""
        node = "" if cls.says_node else f" (node {node_id})"
        error = cls(f"axis {axis}{node}: {said}", axis=axis)
        error.node_id, error.what, error.abort, error.said = node_id, what, abort, said
        return error


class NoAnswer(ObjectError):
    """The drive does not answer."""

    says_node = True


class ReadRefused(ObjectError):
    """The drive does not show the object."""


class WriteRefused(ObjectError):
    """The drive does not take the value."""


def abort_in_words(abort: int) -> str:
    """An SDO abort code (CiA 301) for a person."""
    return f"{ABORTS.get(abort, 'refused')} (SDO abort 0x{abort:08X})"


class Access:
    """The objects of one axis's drive; everything goes through the link."""

    def __init__(self, link: Link, config: AxisConfig, journal: Journal, *, linear: bool) -> None:
        self.config = config
        self.name, self.node_id = config.name, config.node_id
        self.of_node = NodeAxis.by_profile(config.axis_of_node)
        """Which of its node's axes it is: every object here is that axis's."""
        self.who = sentence("axis {axis} (node {node})", axis=self.name, node=config.place)
        self.link, self.journal, self.linear = link, journal, linear
        self.serial = 0
        """0x1018:4, from ``check`` on."""
        row = VENDORS.get(config.vendor)
        if row is None:
            raise DriveError(
                sentence(
                    "axis {axis}: vendor {vendor!r} is not in the table; known are {names} (generic "
                    "asks the drive for everything)",
                    axis=self.name,
                    vendor=config.vendor,
                    names=", ".join(sorted(VENDORS)),
                ),
                axis=self.name,
            )
        self.vendor = row
        self.declared, self.eds_warnings = declared_of(self.name, config.eds, config.node_id)
        link.add_peer(self.node_id, self.name)

    def object_of(self, entry: Entry) -> Object:
        """The object of a journal's entry at its own index; by the size of what stood
        there where its name is not known."""
        known = od.KNOWN.get((of_first_axis(entry.index)[0], entry.sub))
        if known is not None:
            return replace(known, index=entry.index)
        code = {1: "B", 2: "H"}.get(len(entry.before) // 2, "I")
        return Object(entry.index, entry.sub, code, "PDO" if entry.index < 0x2000 else "setting")

    def read(self, what: Object) -> int:
        """Value of an object; NoAnswer or ReadRefused where the drive does not give it."""
        return what.unpack(self.upload(what))

    def find(self, what: Object) -> int | None:
        """Value of an object; ``None`` where the drive lacks it.

        What the EDS does not list is not asked for, but for the drive's own protection: there firmware newer
        than the file may have more.
        """
        declared = self.declared
        own = self.of_node.at(what)
        if declared is not None and what not in PROTECTION and declared.find(own.index, own.sub) is None:
            return None
        data = self.peek(what)
        return None if data is None else what.unpack(data)

    def write(self, what: Object, value: int) -> None:
        """Write, journal first; WriteRefused where the drive does not take it."""
        data = what.pack(value)
        before = self.peek(what)
        if before == data:
            return
        if before is None:
            self.download(what, data)
            return
        address = (self.node_id, self.serial, self.of_node.at(what).index, what.sub)
        self.journal.add(Entry(*address, before.hex(), data.hex()))
        self.download(what, data)
        shown = self.peek(what)
        if shown is not None and shown not in (data, before):
            # rounded or completed by the drive: that is what it will show when this is undone
            self.journal.add(Entry(*address, before.hex(), shown.hex()))

    def peek(self, what: Object) -> bytes | None:
        """Bytes of an object; ``None`` where the drive refuses to show it."""
        try:
            return self.upload(what)[: what.size]
        except ReadRefused:
            return None

    def upload(self, what: Object) -> bytes:
        """Bytes of an object as they came; NoAnswer or ReadRefused where the drive does not give it.

        An abort that does not say that the object is missing may be of the moment: it is asked again.
        """
        what = self.of_node.at(what)
        try:
            try:
                return bytes(self.link.sdo(self.node_id).upload(what.index, what.sub))
            except SdoAbortedError as error:
                if int(error.code) in MISSING:
                    raise
                self.link.wait(AGAIN_S)
                return bytes(self.link.sdo(self.node_id).upload(what.index, what.sub))
        except SdoAbortedError as error:
            code = int(error.code)
            said = f"{what.address} {what.name} cannot be read: {abort_in_words(code)}"
            raise ReadRefused.at(self.name, self.node_id, what, said, code) from None
        except SdoError as error:
            raise self.silence(what, error) from None

    def download(self, what: Object, data: bytes) -> None:
        """Write without journal; WriteRefused where the drive does not take it."""
        what = self.of_node.at(what)
        try:
            self.link.sdo(self.node_id).download(what.index, what.sub, data)
        except SdoAbortedError as error:
            code, value = int(error.code), f"0x{data[::-1].hex()}"
            said = f"{what.address} {what.name} cannot be written ({value}): {abort_in_words(code)}"
            raise WriteRefused.at(self.name, self.node_id, what, said, code) from None
        except SdoError as error:
            raise self.silence(what, error) from None

    def takes(self, what: Object, value: int) -> bool:
        """Whether an object can be written at all, tried with the value that stands there.

        What an EDS says counts; a drive that refuses the value only may take another one.
        """
        own = self.of_node.at(what)
        declared = None if self.declared is None else self.declared.find(own.index, own.sub)
        if declared is not None and declared.access_type in ("ro", "const"):
            return False
        try:
            self.download(what, what.pack(value))
        except WriteRefused as error:
            return error.abort not in READ_ONLY
        return True

    def command(self, what: Object, value: int) -> None:
        """Write an object that is part of running (controlword, mode, targets), without journal."""
        self.download(what, what.pack(value))

    def silence(self, what: Object, error: Exception) -> ObjectError:
        """The error to raise of a drive that does not answer, or not as SDO has it."""
        if isinstance(error, SdoCommunicationError):
            said = sentence(
                "node {node_id} does not answer ({address} {what}); check that the drive has "
                "power, node_id and bit rate, and the cable",
                node_id=self.node_id,
                address=what.address,
                what=what.name,
            )
            return NoAnswer.at(self.name, self.node_id, what, said)
        said = f"{what.address} {what.name}: {error}"
        return ObjectError.at(self.name, self.node_id, what, said)
