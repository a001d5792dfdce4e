"""How a drive fails in what it is asked: kinds that carry the object, the node and the abort code."""

from __future__ import annotations

from typing import Self

from invid.errors import DriveError
from invid_drivers.cia402.objects import Object

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
