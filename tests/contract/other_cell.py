"""Drives of another author (`durand_drive`) in virtual time: what runs did, judged on their plant."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
from durand.network import NetworkABC
from durand.scheduler import VirtualScheduler, set_scheduler

from invid.config import CellConfig
from invid.errors import InvidError
from invid.planning import make_plan
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.measurement import run_measurement
from invid_drivers.stopping_budgets import plan_within
from tests.contract.durand_drive import SUBSTEP, Drive

CYCLE = 0.002
LIMIT, WINDOW, SPEED = 20.0, 0.5, 5.0
SDO_S = 0.0003
"""From a request to its answer."""


class Port(NetworkABC):
    """One node's end of the wire."""

    def __init__(self, bus: OtherBus) -> None:
        self.subscriptions: dict[int, Callable[[int, bytes], None]] = {}
        self._bus = bus
        self.silent = False

    def add_subscription(self, cob_id: int, callback: Callable[[int, bytes], None]) -> None:
        self.subscriptions[cob_id] = callback

    def remove_subscription(self, cob_id: int, callback: Any = None) -> None:
        self.subscriptions.pop(cob_id, None)

    def send(self, cob_id: int, msg: bytes) -> None:
        if not self.silent:
            self._bus.arrive(cob_id, bytes(msg))


class Clock:
    def __init__(self, bus: OtherBus) -> None:
        self._bus = bus

    def now(self) -> float:
        return self._bus.time

    def sleep_until(self, instant: float) -> None:
        self._bus.advance(instant - self._bus.time)


class OtherBus(can.BusABC):
    """The master's end of the wire; it may be plugged in again after a run."""

    def __init__(self, specs: list[dict[str, Any]]) -> None:
        self.channel_info = "other"
        self.time = 0.0
        self.clock = Clock(self)
        self.inbox: deque[tuple[float, int, bytes]] = deque()
        self.sent: list[tuple[float, int, bytes]] = []
        self.at: list[tuple[float, Callable[[], None]]] = []
        """What happens when, in order."""
        self.scheduler = VirtualScheduler()
        set_scheduler(self.scheduler)
        self.drives = [Drive(Port(self), spec) for spec in specs]  # type: ignore[arg-type]
        super().__init__(channel="other")

    def arrive(self, cob_id: int, data: bytes) -> None:
        late = SDO_S if cob_id & 0x780 == 0x580 else 1e-4
        self.inbox.append((self.time + late, cob_id, data))

    def advance(self, seconds: float) -> None:
        end = self.time + seconds
        while self.time < end - 1e-12:
            step = min(SUBSTEP, end - self.time)
            self.scheduler.run(step)
            self.time += step
            while self.at and self.time >= self.at[0][0]:
                self.at.pop(0)[1]()
            for drive in self.drives:
                drive.step(step, self.time)

    def speak(self, cob_id: int, data: bytes) -> None:
        """Somebody else's frame."""
        self.arrive(cob_id, data)
        self._reach(cob_id, data)

    def _reach(self, cob_id: int, data: bytes) -> None:
        for drive in self.drives:
            if not drive.port.silent:  # type: ignore[attr-defined]
                drive.hear(cob_id, data)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sent.append((self.time, msg.arbitration_id, bytes(msg.data)))
        self._reach(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = self.time + (timeout or 0.0)
        while True:
            if self.inbox and self.inbox[0][0] <= self.time + 1e-12:
                _, cob_id, data = self.inbox.popleft()
                return can.Message(
                    arbitration_id=cob_id, data=data, is_extended_id=False, timestamp=self.time
                )
            if self.time >= end - 1e-12:
                return None
            due = self.inbox[0][0] if self.inbox else end
            self.advance(max(1e-9, min(end, due, self.time + SUBSTEP) - self.time))

    def shutdown(self) -> None:
        """The wire stays."""


def config(axes: list[dict[str, Any]], **safety: Any) -> CellConfig:
    """One axis a node, limits of the table above unless told."""
    limits = {"torque_Nm": LIMIT, "position_window_rad": WINDOW, "velocity_rad_per_s": SPEED}
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "other",
            "bus": {"interface": "invid-virtual", "channel": "other", "cycle_s": CYCLE},
            "safety": safety,
            "axes": [
                {"name": f"A{n}", "node_id": n, "limits": limits, "inertia_kgm2": 1.0, **axis}
                for n, axis in enumerate(axes, start=1)
            ],
            "experiments": [
                {"kind": "multisine", "amplitude": 0.2, "band_Hz": [2, 20], "period_s": 1, "periods": 2}
            ],
            "simulation": {},
        }
    )


class OtherCell:
    """A cell, the commands given to it one after another, and what they said."""

    def __init__(
        self, folder: Path, nodes: list[dict[str, Any]], axes: list[dict[str, Any]], **safety: Any
    ) -> None:
        self.folder = folder
        specs = [
            {
                "node_id": n,
                "masses": [1.0],
                **node,
                "values": {"0x6076": 10_000, "0x6072": 10_000, **node.get("values", {})},
            }
            for n, node in enumerate(nodes, start=1)
        ]
        self.bus = OtherBus(specs)
        self.drives = self.bus.drives
        self.config = config(axes, **safety)

    def connect(self) -> Cia402Cell:
        return Cia402Cell(self.bus, self.config, journal=Journal(self.folder / "bus.journal"))

    def check(self) -> str:
        """`invid check`: what it says; empty where the cell is ready."""
        cell = self.connect()
        try:
            cell.check()
            return " ".join(r.text for r in cell.not_ready)
        except InvidError as error:
            return str(error)
        finally:
            cell.close()

    def measure(self) -> InvidError | None:
        """`invid measure`."""
        cell = self.connect()
        try:
            cell.check()
            plan = plan_within(self.config, cell.reports).plan
        except InvidError as error:
            cell.close()
            return error
        try:
            run_measurement(self.config, plan, cell, self.folder / "rec.h5")
        except InvidError as error:
            return error
        return None

    def plan(self) -> Any:
        return make_plan(self.config)
