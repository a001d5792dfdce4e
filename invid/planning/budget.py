"""Bus budget: how much of the bus a cycle takes in the worst case, and what that allows."""

from __future__ import annotations

from dataclasses import dataclass

from invid.config import CellConfig
from invid.errors import ConfigError

RPDO_BYTES = 4
"""0x6040 controlword and 0x6071 target torque."""
TPDO_BYTES = 8
"""0x6064 position, 0x6077 torque, 0x6041 statusword."""


def frame_bits(data_bytes: int) -> int:
    """Worst-case length of a frame with an 11-bit identifier, stuffing and inter-frame space [bit]."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def cycle_bits(drives: int) -> int:
    """SYNC and the PDOs of every drive in one cycle [bit]."""
    return frame_bits(0) + drives * (frame_bits(RPDO_BYTES) + frame_bits(TPDO_BYTES))


def bus_load(drives: int, *, cycle_s: float, bitrate: int, heartbeat_s: float = 0.1) -> float:
    """Share of the bus that cycle and heartbeats (master and drives) take in the worst case."""
    heartbeats = (drives + 1) * frame_bits(1) / heartbeat_s
    return (cycle_bits(drives) / cycle_s + heartbeats) / bitrate


@dataclass(frozen=True)
class BusBudget:
    """Load of the cell's bus and the shortest cycle that it would carry."""

    load: float
    max_load: float
    shortest_cycle_s: float

    @property
    def fits(self) -> bool:
        """Whether the load is allowed."""
        return self.load <= self.max_load


def bus_budget(config: CellConfig) -> BusBudget:
    """The budget of a cell."""
    bus, drives, beat = config.bus, len(config.axes), config.safety.heartbeat_s
    load = bus_load(drives, cycle_s=bus.cycle_s, bitrate=bus.bitrate_bit_per_s, heartbeat_s=beat)
    free = bus.max_load * bus.bitrate_bit_per_s - (drives + 1) * frame_bits(1) / beat
    shortest = cycle_bits(drives) / free if free > 0 else float("inf")
    return BusBudget(load, bus.max_load, shortest)


def require_budget(config: CellConfig) -> BusBudget:
    """The budget; ConfigError where the bus would be over it."""
    budget = bus_budget(config)
    if not budget.fits:
        bus = config.bus
        raise ConfigError(
            f"bus: {len(config.axes)} drives every {bus.cycle_s * 1e3:g} ms load a bus of "
            f"{bus.bitrate_bit_per_s / 1e3:g} kbit/s to {budget.load:.0%} in the worst case, more than "
            f"max_load {budget.max_load:.0%}; set cycle_s to {next_cycle(budget.shortest_cycle_s):g} or "
            "longer"
        )
    return budget


def next_cycle(seconds: float) -> float:
    """The next cycle time that a drive is likely to take."""
    for step in (0.0005, 0.001, 0.002, 0.004, 0.005, 0.008, 0.01, 0.02, 0.05, 0.1):
        if step >= seconds:
            return step
    return seconds
