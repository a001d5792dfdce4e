"""Where one of several axes of a node has its objects, its PDOs and their identifiers."""

from __future__ import annotations

from dataclasses import dataclass, replace

from invid_drivers.cia402.objects import Object

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
