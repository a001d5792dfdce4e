"""The drives of another hand (`tests/machines/foreign`) on a wire in this process: what runs did, judged on
their plant."""

import tempfile
from pathlib import Path
from typing import Any

import can

from invid.config import CellConfig
from invid.planning import make_plan
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from tests.machines.foreign.wire import ForeignWire
from tests.machines.foreign.world import World

CYCLE = 0.002
LIMIT, WINDOW, SPEED = 20.0, 0.5, 5.0
LOADED = {"plant": {"load": 5.0, "propped": True}}
"""5 N·m of 50 rated, on a prop until its drive is first enabled."""


class ForeignBus(ForeignWire):
    """The master's end; the wire stays when it is unplugged, so that the next command finds the cell."""

    def __init__(self, *nodes: dict[str, Any]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="foreign-bus-")
        specs = [
            {"node": n, **spec, "axes": [{"plant": spec.get("plant", {})}]} for n, spec in enumerate(nodes, 1)
        ]
        self.world = World({"nodes": specs}, Path(self._folder.name))
        self.world.ended = True  # no limit in time: pytest has its own
        self.nodes, self.axes = self.world.nodes, self.world.axes
        self.clock = self
        self.sent: list[tuple[float, int, bytes]] = []
        can.BusABC.__init__(self, channel="foreign")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """One frame to the drives, and kept."""
        self.sent.append((self.now(), msg.arbitration_id, bytes(msg.data)))
        super().send(msg, timeout)

    def shutdown(self) -> None:
        """The wire stays."""
        self._is_shutdown = True


class ForeignCell:
    """A cell whose axes are stated to be ``loaded`` or not, and the commands given to it."""

    def __init__(self, folder: Path, nodes: list[dict[str, Any]], loaded: list[bool], **safety: Any) -> None:
        self.folder, self.bus = folder, ForeignBus(*nodes)
        limits = {"torque_Nm": LIMIT, "position_window_rad": WINDOW, "velocity_rad_per_s": SPEED}
        axes = [
            {
                "name": f"A{n}",
                "node_id": n,
                "limits": limits,
                "inertia_kgm2": 1.0,
                "gravity_loaded": is_loaded,
                "brake": "none" if node.get("plant", {}).get("brake") is None else "drive",
            }
            for n, (is_loaded, node) in enumerate(zip(loaded, nodes, strict=True), 1)
        ]
        self.config = CellConfig.model_validate(
            {
                "format": "invid-config",
                "robot": "foreign",
                "bus": {"interface": "invid-virtual", "channel": "foreign", "cycle_s": CYCLE},
                "safety": safety,
                "axes": axes,
                "experiments": [
                    {"kind": "multisine", "amplitude": 0.2, "band_Hz": [2, 20], "period_s": 1, "periods": 2}
                ],
                "simulation": {},
            }
        )

    def connect(self) -> Cia402Cell:
        """A master of its own, as each command makes one."""
        return Cia402Cell(self.bus, self.config, journal=Journal(self.folder / "bus.journal"))

    def plan(self) -> Any:
        """What `invid measure` would run."""
        return make_plan(self.config)
