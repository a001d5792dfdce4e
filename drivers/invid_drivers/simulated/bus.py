"""A python-can bus whose time is virtual: simulated drives answer, the plant moves, nobody waits.

One thread owns the bus. ``send`` queues a frame at the present virtual instant and returns; ``recv``
lets virtual time pass until a frame arrives or its timeout is over; ``clock.sleep_until`` lets it pass
regardless. Between two calls no time passes at all, so ``recv(0)`` in a loop waits for ever.
What is modelled and what is not stands in docs/explanations/simulated-cell.md.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

import can
from can import BusABC, Message

from invid.config import load_config
from invid.config.frames import frame_bits
from invid.config.schema import CellConfig
from invid.errors import InvidError
from invid_drivers.simulated.cell import NEVER, SimulatedCell

_NS = 1_000_000_000
_SILENCE_NS = 60 * _NS
"""How long ``recv(None)`` listens to a silent bus; a heartbeat or a TPDO is never so rare."""

MOST_WAITING = 256
"""Frames that the master may have waiting."""


class VirtualClock:
    """Virtual time of one wire [s]."""

    def __init__(self, wire: VirtualWire) -> None:
        self._wire = wire

    def now(self) -> float:
        """Seconds since the cell was started."""
        return self._wire.now_ns / _NS

    def sleep_until(self, time_s: float) -> None:
        """Let virtual time pass; frames that arrive are kept for ``recv``."""
        self._wire.run(round(time_s * _NS), None)


class VirtualWire:
    """The wire and the cell on it: arbitration by identifier, wire times, virtual time."""

    def __init__(self, cell: SimulatedCell, bitrate: int) -> None:
        self.cell = cell
        self.now_ns = 0
        self._frame_ns = [round(frame_bits(n) * _NS / bitrate) for n in range(9)]
        # frames: identifier, the port that sent it (nodes: a negative running number), data
        self._host: deque[tuple[int, int, bytes]] = deque()
        self._nodes: list[tuple[int, int, bytes]] = []
        self._count = 0
        self._busy: tuple[int, int, bytes] | None = None
        self._busy_until = 0
        self.inboxes: list[deque[tuple[int, int, bytes]] | None] = []
        self.frames = 0
        cell.transmit = self._from_node

    def submit(self, can_id: int, data: bytes, sender: int) -> None:
        """Queue a frame of the master; its queue is first in, first out, as a controller's is."""
        if self.cell.master_off:
            raise can.CanOperationError("the controller is bus-off: too many errors on the wire", 100)
        if len(self._host) >= MOST_WAITING:
            raise can.CanOperationError(
                f"send queue full: {MOST_WAITING} frames wait for the wire; the bus is overloaded", 105
            )
        self._host.append((can_id, sender, data))

    def _from_node(self, can_id: int, data: bytes) -> None:
        self._count += 1
        heappush(self._nodes, (can_id, self._count - NEVER, data))

    def run(self, limit_ns: int, inbox: deque[tuple[int, int, bytes]] | None) -> None:
        """Let time pass to ``limit_ns``, or until ``inbox`` has a frame."""
        cell, frame_ns = self.cell, self._frame_ns
        busy, busy_until = self._busy, self._busy_until
        while True:
            if busy is None:
                busy = self._next_frame()
                if busy is not None:
                    busy_until = self.now_ns + frame_ns[len(busy[2])]
            due = cell.due_ns
            if busy is not None and busy_until <= due:
                if busy_until > limit_ns:
                    break
                self.now_ns = busy_until
                self._busy = None  # the handlers may come back to this wire
                self._deliver(busy)
                busy = None
                if inbox:
                    self._busy = None
                    return
            elif due > limit_ns:
                break
            else:
                if due > self.now_ns:
                    self.now_ns = due
                cell.run_timers(self.now_ns)
        self._busy, self._busy_until = busy, busy_until
        if limit_ns > self.now_ns:
            self.now_ns = limit_ns

    def _next_frame(self) -> tuple[int, int, bytes] | None:
        """Who wins the wire: the lowest identifier."""
        host, nodes = self._host, self._nodes
        if nodes and not (host and host[0][0] <= nodes[0][0]):
            return heappop(nodes)
        if not host:
            return None
        if self.cell.master_off:  # a controller that goes bus-off sends nothing any more
            host.clear()
            return None
        return host.popleft()

    def _deliver(self, frame: tuple[int, int, bytes]) -> None:
        """The frame has been on the wire: to the cell and to every port but its own."""
        now, (can_id, sender, data) = self.now_ns, frame
        self.frames += 1
        if sender >= 0:
            self.cell.receive(can_id, data, now)
            if self.inboxes[sender] is not None:  # who has closed is heard of by the drives alone
                self._spread(now, can_id, data, sender)
        elif not self.cell.master_off:
            self._spread(now, can_id, data, -1)
            self.cell.deliver(can_id, data, now)

    def _spread(self, now_ns: int, can_id: int, data: bytes, sender: int) -> None:
        for number, box in enumerate(self.inboxes):
            if box is not None and number != sender:
                box.append((now_ns, can_id, data))

    def open_inbox(self) -> tuple[int, deque[tuple[int, int, bytes]]]:
        """A further port on the wire."""
        box: deque[tuple[int, int, bytes]] = deque()
        self.inboxes.append(box)
        return len(self.inboxes) - 1, box


_WIRES: dict[str, VirtualWire] = {}


class VirtualTimeBus(BusABC):
    """The master's port on a virtual wire.

    Parameters
    ----------
    channel
        The channel of a cell started with ``open_virtual_bus``, or the path of a cell's YAML config,
        which starts one.

    Raises
    ------
    can.CanInitializationError
        Where the channel is neither.
    """

    def __init__(
        self, channel: Any = None, can_filters: Any = None, *, wire: VirtualWire | None = None, **_: Any
    ) -> None:
        self.wire = wire if wire is not None else _find_wire(str(channel))
        self.clock = VirtualClock(self.wire)
        self.channel_info = f"invid-virtual {channel}"
        self._number, self._inbox = self.wire.open_inbox()
        self._error_shown = False
        super().__init__(channel=channel, can_filters=can_filters)

    @property
    def cell(self) -> SimulatedCell:
        """The cell behind the bus, for tests and for showing the truth."""
        return self.wire.cell

    # --- python-can ------------------------------------------------------------------------------
    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Queue a frame at the present virtual instant.

        Extended, remote and error frames mean nothing to the drives and only take wire time.
        """
        if msg.is_fd or len(msg.data) > 8:
            raise can.CanOperationError("invid-virtual is a classic CAN bus: at most 8 data bytes")
        plain = not (msg.is_extended_id or msg.is_remote_frame or msg.is_error_frame)
        can_id = msg.arbitration_id if plain else 0x20000000 | msg.arbitration_id
        self.wire.submit(can_id, bytes(msg.data), self._number)

    def recv(self, timeout: float | None = None) -> Message | None:
        """The next frame; virtual time passes until it arrives or ``timeout`` [virtual s] is over.

        ``None`` waits for the next frame, but raises after a minute of virtual silence instead of
        hanging on a bus where nothing will ever happen again.
        """
        if self.wire.cell.master_off is not self._error_shown:
            self._error_shown = self.wire.cell.master_off
            if self._error_shown:
                return Message(timestamp=self.clock.now(), is_error_frame=True, is_extended_id=False, dlc=8)
        inbox, wire = self._inbox, self.wire
        if timeout is None:
            end = wire.now_ns + _SILENCE_NS
        else:  # any timeout above zero passes some time: a loop on what is left must end
            end = wire.now_ns + (max(1, round(timeout * _NS)) if timeout > 0.0 else 0)
        while True:
            if not inbox:
                wire.run(end, inbox)
                if not inbox:
                    if timeout is None:
                        raise can.CanOperationError(
                            f"nothing was received in {_SILENCE_NS // _NS} virtual seconds"
                        )
                    return None
            when, can_id, data = inbox.popleft()
            message = Message(when / _NS, can_id & 0x1FFFFFFF, can_id > 0x1FFFFFFF, data=data, dlc=len(data))
            if self._filters is None or self._matches_filters(message):
                return message

    @property
    def state(self) -> can.BusState:
        """ERROR while bus-off."""
        return can.BusState.ERROR if self.wire.cell.master_off else can.BusState.ACTIVE

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("the state of the virtual bus cannot be set")

    def _send_periodic_internal(self, *_: Any, **__: Any) -> Any:
        raise NotImplementedError(
            "invid-virtual sends nothing by itself: its time stands still between two calls; "
            "send each frame when clock.now() says so"
        )

    def flush_tx_buffer(self) -> None:
        """Discard what has not been on the wire."""
        self.wire._host.clear()

    def shutdown(self) -> None:
        """Close this port; the last one to close ends the cell's name."""
        if not self._is_shutdown:
            self.wire.inboxes[self._number] = None
        super().shutdown()
        if any(box is not None for box in self.wire.inboxes):
            return
        for name in [n for n, wire in _WIRES.items() if wire is self.wire]:
            del _WIRES[name]


def _find_wire(channel: str) -> VirtualWire:
    if channel in _WIRES:
        return _WIRES[channel]
    path = Path(channel)
    if not path.is_file():
        raise can.CanInitializationError(
            f"invid-virtual: {channel!r} is neither a running simulated cell nor a config file"
        )
    try:
        config = load_config(path)
        return VirtualWire(SimulatedCell(config), config.bus.bitrate_bit_per_s)
    except InvidError as error:
        raise can.CanInitializationError(f"invid-virtual: {channel}: {error}") from None


def open_virtual_bus(
    config: CellConfig, *, prepare: Callable[[SimulatedCell], None] | None = None
) -> VirtualTimeBus:
    """A fresh simulated cell at virtual time 0 and the master's port on its bus.

    While the port is open, ``can.Bus(interface="invid-virtual", channel=config.bus.channel)`` opens
    a second port on the same wire. ``prepare`` sees the cell before any time passes.
    """
    cell = SimulatedCell(config)
    if prepare is not None:
        prepare(cell)
    wire = VirtualWire(cell, config.bus.bitrate_bit_per_s)
    _WIRES[config.bus.channel] = wire
    return VirtualTimeBus(config.bus.channel, wire=wire)
