"""The simulated drives in real time, on any python-can bus, for a master in another process."""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import can
from can import BusABC, Message

from invid.config.schema import CellConfig
from invid.errors import BusError, ConfigError
from invid_drivers.adapters import open_adapter
from invid_drivers.scheduling import lock_memory, priority
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.simulated.node import Nmt
from invid_drivers.simulated.unix_bus import UnixHub

_NS = 1_000_000_000
PRIORITY = 5
"""SCHED_FIFO below any master's priority: the loop sleeps in ``recv`` and starves nobody."""
_LONGEST_WAIT_NS = 20_000_000
"""How long the loop may sleep before it looks at the stop event: 20 ms is not felt at a Ctrl-C."""
_OLDEST_NS = _NS
"""A frame's stamp further back is of another clock (some interfaces count from their start)."""


@dataclass
class SimcellStatistics:
    """What a run of the simulated cell did."""

    duration_s: float = 0.0
    frames_received: int = 0
    frames_sent: int = 0
    frames_not_sent: int = 0
    syncs: int = 0
    late_max_s: float = 0.0
    """Worst lateness of a timer."""
    realtime: bool = False
    """Whether the kernel granted SCHED_FIFO."""
    drives: list[dict[str, Any]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Document of ``invid simcell --json``."""
        return {"format": "invid-simcell", "format_version": 1, "simulated": True, **asdict(self)}


def open_cell_bus(config: CellConfig) -> BusABC:
    """The drives' side of the bus that the config names.

    Raises
    ------
    ConfigError
        Where the bus exists in virtual time only, or python-can has no such interface.
    BusError
        Where the bus cannot be opened.
    """
    bus = config.bus
    if bus.interface == "invid-virtual":
        raise ConfigError(
            "bus.interface: invid-virtual lives inside the master's process and has no real time; "
            "give the simulated cell invid-unix, socketcan or another python-can interface"
        )
    if bus.interface != "invid-unix":
        return open_adapter(bus)
    try:
        return UnixHub(bus.channel)
    except can.CanError as error:
        raise BusError(f"bus {bus.interface} {bus.channel!r}: cannot be opened: {error}") from None


def run_simcell(
    config: CellConfig,
    stop_event: threading.Event,
    *,
    bus: BusABC | None = None,
    ready: Callable[[], object] | None = None,
    realtime: bool = False,
) -> SimcellStatistics:
    """Run the drives until ``stop_event`` is set; ``bus`` as opened, else as the config names it.

    ``ready`` is called once every drive has booted.

    ``realtime`` asks the kernel for SCHED_FIFO and says in the statistics whether it was granted.

    Raises
    ------
    ConfigError
        Where there is nothing to simulate, or the bus exists in virtual time only.
    BusError
        Where the bus cannot be opened or fails for good.
    """
    own = bus is None
    cell = SimulatedCell(config)
    wire = open_cell_bus(config) if bus is None else bus
    collecting = gc.isenabled()
    try:
        # compile or load the kernel before the first frame is due
        cell.plant.advance_to(0)
        loop = _Loop(cell, wire)
        loop.warm_up()
        if own:  # the process is the cell's own: no pauses for collection
            gc.disable()
        with priority(PRIORITY) if realtime else contextlib.nullcontext(False) as granted:
            if granted:
                lock_memory()
            loop.run(stop_event, ready)
        return replace(loop.statistics(), realtime=granted)
    finally:
        if collecting:
            gc.enable()
        if own:
            wire.shutdown()


class _Loop:
    """Passes frames and timers to the cell against the monotonic clock."""

    def __init__(self, cell: SimulatedCell, bus: BusABC) -> None:
        self._cell, self._bus = cell, bus
        self._not_sent = 0
        self._late_ns = 0
        self._start_ns = time.monotonic_ns()
        self._wall_ns = self._next_comparison_ns = 0
        cell.transmit = self._send
        cell.plant.exact_instants = False

    def warm_up(self) -> None:
        """Touch the compiled code once, without moving anything."""
        probe = SimulatedCell(self._cell.config)
        probe.run_timers(5_000_000)
        self._start_ns = time.monotonic_ns()

    def _now(self) -> int:
        return time.monotonic_ns() - self._start_ns

    def _send(self, can_id: int, data: bytes) -> None:
        if self._cell.master_off:
            return
        try:
            self._bus.send(Message(arbitration_id=can_id, is_extended_id=False, data=data))
        except can.CanError:  # a full queue or no listener: a drive does not care
            self._not_sent += 1

    def run(self, stop_event: threading.Event, ready: Callable[[], object] | None) -> None:
        """Run until stopped; ``ready`` is called once every drive has booted.

        Frames and timers take effect in the order and at the instants at which they were sent and due,
        even where this process woke late: a real drive samples when SYNC is on the wire. Only its answers
        are then late.
        """
        cell, bus = self._cell, self._bus
        failures = 0
        while not stop_event.is_set():
            if ready is not None and all(d.node.state is not Nmt.INITIALISING for d in cell.drives):
                ready()
                ready = None
            now = self._now()
            wait = min(max(cell.due_ns - now, 0), _LONGEST_WAIT_NS)
            try:
                message = bus.recv(wait / _NS)
                failures = 0
            except can.CanError as error:
                failures += 1
                if failures > 100:
                    raise BusError(f"bus: receiving failed {failures} times in a row: {error}") from None
                time.sleep(0.001)
                continue
            if message is None:
                # Every frame sent before ``now`` has been seen.
                self._timers_until(now)
                continue
            if cell.master_off:
                continue
            if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
                continue
            sent = self._sent(message)
            self._timers_until(sent)
            cell.receive(message.arbitration_id, bytes(message.data), max(sent, cell.now_ns))

    def _timers_until(self, instant_ns: int) -> None:
        cell = self._cell
        if cell.due_ns > instant_ns:
            return
        self._late_ns = max(self._late_ns, self._now() - cell.due_ns)
        while cell.due_ns <= instant_ns:
            cell.run_timers(cell.due_ns)

    def _sent(self, message: Message) -> int:
        """When a frame was on the wire, by the kernel's stamp where there is a plausible one."""
        now = self._now()
        if now >= self._next_comparison_ns:
            self._compare_clocks()
            self._next_comparison_ns = now + _NS
        sent = round(message.timestamp * _NS) - self._wall_ns
        return sent if 0 <= now - sent < _OLDEST_NS else now

    def _compare_clocks(self) -> None:
        """Set the wall clock at the cell's start, by the closest of a few looks."""
        best = _NS
        for _ in range(10):
            before = time.monotonic_ns()
            wall = time.time_ns()
            took = time.monotonic_ns() - before
            if took < best:
                best, self._wall_ns = took, wall - before - took // 2 + self._start_ns

    def statistics(self) -> SimcellStatistics:
        """What was done so far."""
        cell = self._cell
        return SimcellStatistics(
            duration_s=self._now() / _NS,
            frames_received=cell.frames_in,
            frames_sent=cell.frames_out - self._not_sent,
            frames_not_sent=self._not_sent,
            syncs=cell.syncs,
            late_max_s=self._late_ns / _NS,
            drives=[
                {
                    "axis": axis.name,
                    "node_id": axis.node_id,
                    "state": drive.state.name.lower(),
                    "position": float(cell.plant.positions[cell.plant.structure.motors[drive.row]]),
                }
                for axis, drive in zip(cell.config.axes, cell.drives, strict=True)
            ],
        )
