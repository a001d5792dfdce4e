"""Who else is on the bus: what a frame that is not ours means, by the connections that CiA 301 sets up.

Another master drives the same nodes, or takes them out of operation; another slave only talks of itself. PDOs
may have been given other identifiers than CiA 301's: what is named here is what the identifier usually is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import can

from invid_drivers.cia402.gate import Peer

MASTER_ID = 127
"""Node id of the service in its own heartbeat; axes have 1…126."""
LISTEN_S = 1.2
"""So long nothing is sent at first: heartbeats are seldom rarer than one in a second."""
LISTEN_BEATS = 3
"""And no shorter than so many of our own heartbeats, by which this bus is known to be slow."""
_NMT = {0x01: "start", 0x02: "stop", 0x80: "pre-operational", 0x81: "reset node", 0x82: "reset communication"}


@dataclass(frozen=True)
class Foreign:
    """What was heard of somebody else."""

    text: str
    master: bool
    """Whether only a master sends it."""
    node: int | None = None
    """The slave that sent it, where it is one."""


def foreign(message: can.Message, own: Mapping[int, Peer]) -> Foreign | None:
    """What a frame says of others; ``None`` where it is of our nodes or says nothing.

    Parameters
    ----------
    own
        Our nodes by their ids.
    """
    cob = message.arbitration_id
    if message.is_extended_id:
        return Foreign("frames with 29-bit identifiers", master=False)
    node, function = cob & 0x7F, cob & 0x780
    whom = f"node {node}" + (f" (axis {own[node].name})" if node in own else "")
    at = f"(COB-ID 0x{cob:03X})"
    if message.is_remote_frame:
        return Foreign(f"node guarding of {whom} {at}", master=True) if function == 0x700 else None
    if cob == 0x000:
        return Foreign(_nmt(bytes(message.data), own), master=True)
    masters = {
        0x080: f"SYNC {at}",
        0x7E5: f"LSS {at}: somebody sets node ids",
        0x700 + MASTER_ID: f"a heartbeat with our own node id {MASTER_ID} {at}",
    }
    if cob in masters:
        return Foreign(masters[cob], master=True)
    if function in (0x200, 0x300, 0x400, 0x500) and node:
        return Foreign(f"RPDO {(function - 0x100) // 0x100} to {whom} {at}", master=True)
    if function == 0x600 and node:
        return Foreign(f"an SDO request to {whom} {at}", master=True)
    if function in (0x080, 0x180, 0x280, 0x380, 0x480, 0x700) and node and node not in own:
        return Foreign(f"node {node} {at}", master=False, node=node)
    return None


def _nmt(data: bytes, own: Mapping[int, Peer]) -> str:
    if len(data) < 2:
        return "NMT (COB-ID 0x000)"
    what = _NMT.get(data[0], f"0x{data[0]:02X}")
    axis = f" (axis {own[data[1]].name})" if data[1] in own else ""
    whom = "all nodes" if data[1] == 0 else f"node {data[1]}{axis}"
    return f"NMT '{what}' to {whom} (COB-ID 0x000)"
