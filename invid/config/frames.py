"""Lengths of the frames of a cycle, and the shortest heartbeat that cycle and bus carry."""

from __future__ import annotations

import math

RPDO_BYTES = 4
"""0x6040 controlword and 0x6071 target torque."""
TPDO_BYTES = 8
"""0x6064 position, 0x6077 torque, 0x6041 statusword."""
WATCH_BEATS = 3
"""Heartbeats of the master after which a drive stops by itself (0x1016)."""
PAUSE_CYCLES = 3
"""Cycles beyond those that may be skipped before a drive may take its master for dead: the answers of a cycle
that the adapter carries come within one, and two are left to the slots around a pause."""
LONGEST_HEARTBEAT_S = 0.1
"""Heartbeat of a slow cycle or a full bus."""


def frame_bits(data_bytes: int) -> int:
    """Worst-case length of a frame with an 11-bit identifier, stuffing and inter-frame space [bit]."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def cycle_bits(drives: int) -> int:
    """SYNC and the PDOs of every drive in one cycle [bit]."""
    return frame_bits(0) + drives * (frame_bits(RPDO_BYTES) + frame_bits(TPDO_BYTES))


def shortest_heartbeat(
    cycle_s: float, skipped: int, *, drives: int, bitrate: float, max_load: float = 1.0
) -> float:
    """The shortest heartbeat [s, whole ms] whose watch outlasts every pause that the run forgives.

    A pause of ``skipped`` slots comes after a heartbeat at worst, and the next one may be a period late:
    ``WATCH_BEATS``·T ≥ T + (skipped + ``PAUSE_CYCLES``)·cycle. The heartbeats of master and drives must fit
    beside the cycle into what may be used of the bus.
    """
    by_pause = (skipped + PAUSE_CYCLES) * cycle_s / (WATCH_BEATS - 1)
    free = max_load * bitrate - cycle_bits(drives) / cycle_s
    by_bus = (drives + 1) * frame_bits(1) / free if free > 0 else math.inf
    milliseconds = 1e3 * max(by_pause, by_bus)
    if not milliseconds < 1e3 * LONGEST_HEARTBEAT_S:
        return LONGEST_HEARTBEAT_S
    return math.ceil(milliseconds - 1e-9) / 1e3
