"""A foreign peer: CiA 402 drives on `durand` nodes, on a virtual-time bus, rigid masses behind them.

Nothing here is shared with the simulated drives of the package: SDO, NMT, SYNC, PDOs and heartbeat are
durand's, the state machine below is typed from the standard's figure.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import can
from durand import MinimalNode, Record, Variable
from durand.datatypes import DatatypeEnum as DT
from durand.network import NetworkABC
from durand.scheduler import VirtualScheduler, set_scheduler

COUNTS = 1 << 20
LONGEST_STEP_S = 0.02

# index: (type, access, value)
OBJECTS: dict[int, tuple[DT, str, int]] = {
    0x1000: (DT.UNSIGNED32, "ro", 0x00020192),
    0x6007: (DT.INTEGER16, "rw", 1),
    0x603F: (DT.UNSIGNED16, "ro", 0),
    0x6040: (DT.UNSIGNED16, "rw", 0),
    0x6041: (DT.UNSIGNED16, "ro", 0x0040),
    0x605A: (DT.INTEGER16, "rw", 2),
    0x6060: (DT.INTEGER8, "rw", 0),
    0x6061: (DT.INTEGER8, "ro", 0),
    0x6064: (DT.INTEGER32, "ro", 0),
    0x6065: (DT.UNSIGNED32, "rw", 0xFFFFFFFF),
    0x6066: (DT.UNSIGNED16, "rw", 0),
    0x6071: (DT.INTEGER16, "rw", 0),
    0x6072: (DT.UNSIGNED16, "rw", 3000),
    0x6076: (DT.UNSIGNED32, "ro", 10_000),
    0x6077: (DT.INTEGER16, "ro", 0),
    0x607A: (DT.INTEGER32, "rw", 0),
    0x607F: (DT.UNSIGNED32, "rw", 0xFFFFFFFF),
    0x6502: (DT.UNSIGNED32, "ro", 1 << 7 | 1 << 9),
}
RECORDS: dict[int, tuple[DT, str, tuple[int, ...]]] = {
    0x1016: (DT.UNSIGNED32, "rw", (0,)),
    0x607D: (DT.INTEGER32, "rw", (-(2**31), 2**31 - 1)),
    0x608F: (DT.UNSIGNED32, "rw", (COUNTS, 1)),
}


class Port(NetworkABC):
    """One node's end of the wire; durand keeps one callback per COB-ID and network."""

    def __init__(self, wire: DurandBus) -> None:
        self.subscriptions: dict[int, Callable[[int, bytes], None]] = {}
        self._wire = wire
        self.silent = False

    def add_subscription(self, cob_id: int, callback: Callable[[int, bytes], None]) -> None:
        self.subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id: int) -> None:
        self.subscriptions.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        if not self.silent:
            self._wire.inbox.append((cob_id, bytes(msg)))


class Clock:
    def __init__(self, wire: DurandBus) -> None:
        self._wire = wire

    def now(self) -> float:
        return self._wire.time

    def sleep_until(self, instant: float) -> None:
        self._wire.advance(instant - self._wire.time)


class DurandDrive:
    """The application: states of the standard's figure, torque and position mode, one rigid mass."""

    def __init__(
        self,
        port: Port,
        node_id: int,
        inertia: float,
        *,
        lacks: frozenset[int] = frozenset(),
        values: Mapping[int, int] | None = None,
    ) -> None:
        self.node = MinimalNode(port, node_id)
        self.port = port
        self.inertia = inertia
        self.x, self.v, self.torque = 0.0, 0.0, 0.0
        self.state = "switch on disabled"
        od = self.node.object_dictionary
        self.od = od
        for index, (kind, access, value) in OBJECTS.items():
            if index not in lacks:
                od[index] = Variable(kind, access, (values or {}).get(index, value))
        for index, (kind, access, subs) in RECORDS.items():
            if index not in lacks:
                record = Record()
                for sub, value in enumerate(subs, start=1):
                    record[sub] = Variable(kind, access, value)
                od[index] = record
        od.download_callbacks[(0x6040, 0)].add(self.control)
        if 0x6060 not in lacks:
            od.download_callbacks[(0x6060, 0)].add(lambda mode: od.write(0x6061, 0, mode))

    def control(self, word: int) -> None:
        """Device control commands of IEC 61800-7-201."""
        before = self.state
        if not word & 0x02:
            self.state = "switch on disabled"
        elif not word & 0x04:
            # quick stop; option code 2: stop, then switch on disabled. A rigid axis stops at once here.
            self.state = "switch on disabled"
            self.v = 0.0
        elif word & 0x0F == 0x06 and before in ("switch on disabled", "switched on", "operation enabled"):
            self.state = "ready to switch on"
        elif word & 0x0F == 0x07 and before in ("ready to switch on", "operation enabled"):
            self.state = "switched on"
        elif word & 0x0F == 0x0F and before == "switched on":
            self.state = "operation enabled"
        bits = {
            "switch on disabled": 0x40,
            "ready to switch on": 0x21,
            "switched on": 0x23,
            "operation enabled": 0x27,
        }[self.state]
        self.od.write(0x6041, 0, 0x0200 | bits)

    def step(self, dt: float) -> None:
        """Constant torque over ``dt``."""
        if not {0x6071, 0x6077} <= self.od._variables.keys() or dt <= 0:
            return
        enabled = self.state == "operation enabled"
        mode = self.od.read(0x6061, 0)
        self.torque = 10.0 * self.od.read(0x6071, 0) / 1000 if enabled and mode == 10 else 0.0
        if enabled and mode == 8:
            self.v = 0.0
        a = self.torque / self.inertia
        self.x += self.v * dt + 0.5 * a * dt * dt
        self.v += a * dt
        self.od.write(0x6064, 0, round(self.x / (2 * math.pi) * COUNTS))
        self.od.write(0x6077, 0, round(self.torque * 100))


class DurandBus(can.BusABC):
    """The master's end of the wire."""

    def __init__(self, inertias: Mapping[int, float], **gaps: Any) -> None:
        self.channel_info = "durand"
        self.inbox: deque[tuple[int, bytes]] = deque()
        self.time = 0.0
        self.scheduler = VirtualScheduler()
        set_scheduler(self.scheduler)
        self.clock = Clock(self)
        self.drives = [DurandDrive(Port(self), n, m, **gaps) for n, m in inertias.items()]
        self.sent: list[tuple[int, bytes]] = []
        super().__init__(channel="durand")

    def advance(self, seconds: float) -> None:
        """Let virtual time pass, in steps: durand's scheduler never ends a run longer than an interval."""
        while seconds > 0:
            step = min(seconds, LONGEST_STEP_S)
            self.scheduler.run(step)
            self.time += step
            for drive in self.drives:
                drive.step(step)
            seconds -= step

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append((msg.arbitration_id, bytes(msg.data)))
        for drive in self.drives:
            callback = drive.port.subscriptions.get(msg.arbitration_id)
            if callback is not None and not drive.port.silent:
                callback(msg.arbitration_id, bytes(msg.data))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.inbox:
            self.advance(min(timeout or 0.0, 1e-4))
            if not self.inbox:
                self.advance((timeout or 0.0) - 1e-4)
        if not self.inbox:
            return None, False
        cob_id, data = self.inbox.popleft()
        return can.Message(arbitration_id=cob_id, data=data, is_extended_id=False, timestamp=self.time), False

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """python-can's own loop measures real time; here time is virtual."""
        return self._recv_internal(timeout)[0]
