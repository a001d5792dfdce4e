"""Devices on the cell's bus that belong to somebody else: to be left alone by every command."""

from __future__ import annotations

from invid_drivers.simulated.node import Host, Nmt, Node
from invid_drivers.simulated.object_dictionary import Nameplate, drive_dictionary
from invid_drivers.simulated.vendors import PROFILES

_MS = 1000.0


class ForeignNode(Node):
    """A node that is operational from the start and notes every change of its NMT state."""

    nmt_changes: list[Nmt]

    def power_on(self, now_ns: int) -> None:
        """Note a reset by anybody, and boot."""
        self.nmt_changes.append(Nmt.INITIALISING)
        super().power_on(now_ns)

    def _set_state(self, state: Nmt, now_ns: int) -> None:
        if state is not self.state:
            self.nmt_changes.append(state)
        super()._set_state(state, now_ns)


class _Device:
    """An application that does nothing."""

    def tick(self, now_ns: int) -> None:
        """Do nothing: there is nothing to act on."""

    def configured(self) -> None:
        """Do nothing: there is nothing to take over."""

    def connection_lost(self, now_ns: int) -> None:
        """Do nothing: there is nothing to stop."""

    def reset(self, now_ns: int) -> None:
        """Do nothing: there is nothing to forget."""


def foreign_node(node_id: int, host: Host, *, heartbeat_s: float) -> ForeignNode:
    """A drive of another cell, as its own master left it: operational, with or without a heartbeat."""
    plate = Nameplate("another cell's drive", serial=1000 + node_id, rated_torque=1.0, encoder_counts=4096)
    od = drive_dictionary(node_id, plate, PROFILES["generic"])
    node = ForeignNode(node_id, od, host, sdo_ns=200_000, boot_ns=2_000_000)
    node.nmt_changes = []
    node.application = _Device()
    od.put(0x1017, 0, round(heartbeat_s * _MS))
    node.state = Nmt.OPERATIONAL
    node._start_heartbeat(None)
    return node
