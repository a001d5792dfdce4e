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


@dataclass(frozen=True)
class NodeAxis:
    """One axis of a node, counted from 1.

    What belongs to the node is all its axes': NMT state, heartbeat (0x1016, 0x1017), SYNC, emergencies,
    identity (0x1000, 0x1018) and the SDO channel. Objects below 0x6000 that a vendor keeps for each axis lie
    where he put them.
    """

    number: int = 1

    def at(self, what: Object) -> Object:
        """The same object of this axis."""
        of_profile = 0x6000 <= what.index < 0x6000 + APART
        return replace(what, index=what.index + APART * (self.number - 1)) if of_profile else what

    @property
    def pdo(self) -> int:
        """Number of the PDO, of either kind, that this axis exchanges in every cycle, counted from 1."""
        return 1 + PDOS * (self.number - 1)

    def cob_id(self, kind: str, node_id: int) -> int:
        """Identifier of that "RPDO" or "TPDO"."""
        return {"RPDO": 0x200, "TPDO": 0x180}[kind] + COB_IDS * (self.number - 1) + node_id
