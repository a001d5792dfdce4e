"""The one gate: whatever leaves for the bus passes it, and what is not permitted now stays here.

Until others were listened for, nothing leaves. A node that was not read in this session is only asked. Under
power a node hears its own master and nobody else, and nothing of what is written then permits it more.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import can

from invid.errors import BusError
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.objects import KNOWN, of_first_axis
from invid_drivers.cia402.states import DriveState, is_energised, state_of

NMT, SYNC, RPDOS, SDO, HEARTBEAT = 0x000, 0x080, (0x200, 0x300, 0x400, 0x500), 0x600, 0x700
FUNCTION, NODE = 0x780, 0x07F
DOWNLOAD, SEGMENT, UPLOAD = 1, 0, 2
"""SDO requests by their command specifier (CiA 301); all others but these two only ask."""
NMT_STOPPED = 4
"""In a heartbeat: the node answers no SDO until it is set pre-operational."""
COMMANDS = frozenset(
    what.index
    for what in (
        od.CONTROLWORD, od.MODE, od.QUICK_STOP_OPTION, od.TARGET_POSITION, od.TARGET_TORQUE, od.TORQUE_OFFSET,
    )
)  # fmt: skip
"""Objects that command an energised drive: none of them is a limit."""
UPPER = frozenset(
    (what.index, what.sub)
    for what in (
        od.MAX_TORQUE, od.MAX_CURRENT, od.POSITION_LIMIT_HIGH, od.MAX_VELOCITY, od.MAX_MOTOR_SPEED,
        od.FOLLOWING_WINDOW, od.FOLLOWING_TIME, od.CONSUMER_HEARTBEAT, od.PRODUCER_HEARTBEAT,
        od.RPDO_EVENT_TIMER,
    )
)  # fmt: skip
LOWER = frozenset(
    (what.index, what.sub)
    for what in (
        od.POSITION_LIMIT_LOW, od.ABORT_CONNECTION, od.QUICK_STOP_DECELERATION, od.PROFILE_DECELERATION,
    )
)  # fmt: skip
"""Objects that permit the less the smaller, and the larger, they are; written under power only that way."""
ZERO_IS_NONE = frozenset({0x1016, 0x1017, 0x1400, 0x607D})
"""Of these 0 limits nothing."""


class NotPermitted(BusError):
    """A frame that the gate kept back."""


NO_ERROR_BELOW = 0x0100
"""Codes of CiA 301: 00xx says that an error has gone."""
MISSES_MASTER, RPDO_TIMEOUT = (0x8100, 0x8700), 0x8250
"""Classes of EMCY with which a drive says that its master is gone: communication, SYNC (CiA 301, 402); and
the code for an RPDO that did not come (0x1400:5)."""


@dataclass
class Peer:
    """What is known of one of our nodes in this session."""

    node_id: int
    name: str
    """Of its axes."""
    last_heartbeat: float | None = None
    nmt_state: int | None = None
    """As its last heartbeat says. NMT stopped: nothing can be read of it before it is set pre-operational."""
    booted: bool = False
    """It has restarted."""
    emcy: list[tuple[float, int]] = field(default_factory=list)
    states: dict[int, DriveState] = field(default_factory=dict)
    """Of its axes, as last read."""
    ours: bool = False
    """Commanded by this master, which also brings it to rest."""
    left_alone: bool = False
    """What it shows may not be believed: it waits for a person."""
    found: dict[tuple[int, int], int] = field(default_factory=dict)
    """Limits by index and subindex, as it last showed them."""

    @property
    def state(self) -> DriveState | None:
        """The state of an axis of it that is energised, or else of any; ``None``: none was read."""
        states = self.states.values()
        return next((s for s in states if is_energised(s)), next(iter(states), None))

    @property
    def why_not(self) -> str:
        """Why it may be sent no NMT command and no setting; empty where it may."""
        if self.ours:
            return ""
        if self.left_alone:
            return "it waits for a person"
        if self.state is None:
            return "" if self.nmt_state == NMT_STOPPED else "it was not read in this session"
        return f"it is under power, in {self.state.words}" if is_energised(self.state) else ""

    def own_errors(self, since: float) -> list[int]:
        """Return the codes of errors reported since an instant, but for those that miss a master."""
        return [
            code
            for said, code in self.emcy
            if said >= since
            and code >= NO_ERROR_BELOW
            and code & 0xFF00 not in MISSES_MASTER
            and code != RPDO_TIMEOUT
        ]

    @property
    def recovered(self) -> float:
        """Instant at which it last said that its errors are gone; 0 where it never did."""
        return max((said for said, code in self.emcy if code < NO_ERROR_BELOW), default=0.0)


class Gate:
    """Judges each frame before it leaves, by what is known of every node; keeps what has left."""

    def __init__(self) -> None:
        self.nodes: dict[int, Peer] = {}
        self.listened = False
        self.disputed = False
        """Another master was heard: what is not ours by now is its."""
        self._asked = self._told = False
        self._sync_ours = False

    # --- what is known -------------------------------------------------------------------------
    def heard(self, cob: int, data: bytes) -> None:
        """Note what an SDO answer or a heartbeat says of its node."""
        node = self.nodes.get(cob & NODE)
        if node is None or not data:
            return
        if cob & FUNCTION == HEARTBEAT:
            node.nmt_state = data[0] & 0x7F
            if node.nmt_state == 0:
                node.booted = True
                node.states.clear()
        elif data[0] >> 5 == UPLOAD and len(data) == 8:
            index, sub = int.from_bytes(data[1:3], "little"), data[3]
            first, axis = of_first_axis(index)
            if (first, sub) == (od.STATUSWORD.index, od.STATUSWORD.sub):
                node.states[axis] = state_of(int.from_bytes(data[4:6], "little"))
            elif (first, sub) in UPPER or (first, sub) in LOWER:
                node.found[index, sub] = KNOWN[first, sub].unpack(data[4:8])

    def saw(self, node_id: int, axis: int, status: int) -> None:
        """Note the state of an axis in a statusword that came in the cycle."""
        self.nodes[node_id].states[axis] = state_of(status)

    def take(self, node_id: int) -> None:
        """Note that this master commands the node from here on."""
        self.nodes[node_id].ours = True
        self._sync_ours = True

    def may_let_go(self, node_id: int) -> bool:
        """Whether a node may be set pre-operational and written to: it would lose no torque by it."""
        node = self.nodes[node_id]
        off = node.state is None or not is_energised(node.state)
        return off and not node.why_not and (node.ours or not self.disputed)

    @property
    def said(self) -> str:
        """What has left so far, in words."""
        if self._sync_ours:
            return "the axes were stopped"
        if self._told:
            return "nothing was moved"
        return "nothing but questions was sent" if self._asked else "nothing was sent"

    # --- what leaves ---------------------------------------------------------------------------
    def pass_out(self, message: can.Message) -> None:
        """Raise NotPermitted where a frame may not leave now."""
        cob = message.arbitration_id
        function = cob & FUNCTION
        if function in RPDOS:
            node = self.nodes.get(cob & NODE)
            if node is not None and node.ours:
                return
        why = self._why_not(function, cob & NODE, bytes(message.data))
        if why:
            raise NotPermitted(f"frame 0x{cob:03X} was kept back: {why}")

    def _why_not(self, function: int, node_id: int, data: bytes) -> str:
        if not self.listened:
            return "nothing is sent before it is known who else is on the bus"
        if function == HEARTBEAT or (function == SYNC and self._sync_ours):
            return ""
        if function == SDO and data[0] >> 5 not in (DOWNLOAD, SEGMENT):
            self._asked = True
            return ""
        node = self.nodes.get(data[1] if function == NMT and len(data) == 2 else node_id)
        if node is None or function not in (NMT, SDO):
            return "nobody of this cell is meant by it"
        why = node.why_not or ("another master was heard" if self.disputed and not node.ours else "")
        if why:
            return f"axis {node.name}: {why}"
        powered = node.state is not None and is_energised(node.state)
        if function == SDO and data[0] >> 5 == DOWNLOAD and powered and not _tightens(node, data):
            at = f"0x{int.from_bytes(data[1:3], 'little'):04X}:{data[3]}"
            return f"axis {node.name}: {at} is not widened under power"
        self._told = True
        return ""


def _tightens(node: Peer, data: bytes) -> bool:
    """Whether what is written commands, or permits at most what was found."""
    index, sub = int.from_bytes(data[1:3], "little"), data[3]
    at = of_first_axis(index)[0], sub
    if at[0] in COMMANDS:
        return True
    found = node.found.get((index, sub))
    if found is None:
        return False
    value = KNOWN[at].unpack(data[4:8])
    if found == 0 and at[0] in ZERO_IS_NONE:
        return True
    return value >= found if at in LOWER else value <= found
