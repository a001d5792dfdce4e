"""Faults that a cell's configuration injects: when, where, what.

A fault begins ``at_s`` seconds after the cell starts, or ``after_s`` seconds after an axis first
reaches a state of the CiA 402 state machine, and lasts ``duration_s`` (default: for good). Faults on
frames are drawn from the cell's seed, so that a run repeats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from invid_drivers.cia402.states import DriveState
from invid_drivers.simulated import kernel
from invid_drivers.simulated.config import FRAME_FAULTS, FaultConfig
from invid_drivers.simulated.drive import Drive

if TYPE_CHECKING:
    from invid_drivers.simulated.cell import SimulatedCell

_NS = 1_000_000_000
_LOOK_NS = 1_000_000  # how often an awaited state is looked for: the drives' own control period

_SWITCHES: dict[str, tuple[str, Callable[[FaultConfig], float | bool]]] = {
    "ignore_quick_stop": ("ignore_quick_stop", lambda fault: True),
    "ignore_controlword": ("ignore_controlword", lambda fault: True),
    "ignore_target": ("ignore_target", lambda fault: True),
    "statusword": ("statusword_lie", lambda fault: fault.value & 0xFFFF),
    "mode_display": ("mode_lie", lambda fault: fault.value),
    "torque_display": ("torque_lie", lambda fault: fault.value),
    "torque_scale": ("torque_gain", lambda fault: fault.gain),
}
"""What a fault sets of the drive, and to what."""


@dataclass
class FrameFault:
    """An active fault on frames."""

    config: FaultConfig
    ids: frozenset[int] | None
    left: int | None

    def hits(self, can_id: int, random: np.random.Generator) -> bool:
        """True where this frame suffers."""
        if self.ids is not None and can_id not in self.ids:
            return False
        if self.left == 0:
            return False
        if self.config.rate < 1.0 and random.random() >= self.config.rate:
            return False
        if self.left is not None:
            self.left -= 1
        return True


Frames = list[tuple[float, bytes]]


def disturb(faults: list[FrameFault], can_id: int, data: bytes, random: np.random.Generator) -> Frames:
    """What becomes of a frame: a list of (delay [s], data); empty where it is lost."""
    frames: Frames = [(0.0, data)]
    for fault in faults:
        if not fault.hits(can_id, random):
            continue
        kind = fault.config.kind
        if kind == "drop":
            return []
        if kind == "delay":
            frames = [(late + fault.config.delay_s, d) for late, d in frames]
        elif kind == "duplicate":
            frames = frames + frames
        elif kind == "corrupt":
            frames = [(late, _flip(d, random)) for late, d in frames]
    return frames


def _flip(data: bytes, random: np.random.Generator) -> bytes:
    """One flipped bit, or another length where there is no data to flip."""
    if not data:
        return bytes([int(random.integers(256))])
    bit = int(random.integers(8 * len(data)))
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)


class FaultInjector:
    """Begins and ends the faults of one cell."""

    def __init__(self, cell: SimulatedCell) -> None:
        self._cell = cell
        self.frames: list[FrameFault] = []
        """Active faults on frames."""

    def plan(self, fault: FaultConfig) -> None:
        """Let a fault happen when its time or state comes."""
        cell = self._cell
        if fault.at_s is not None:
            cell.schedule(round(fault.at_s * _NS), lambda now_ns: self.begin(fault, now_ns))
            return
        wanted = DriveState[(fault.at_state or "").upper()]
        drive = cell.drive(fault.axis)

        def wait(now_ns: int) -> None:
            if drive.state is wanted:
                cell.schedule(now_ns + round(fault.after_s * _NS), lambda at_ns: self.begin(fault, at_ns))
            else:
                cell.schedule(now_ns + _LOOK_NS, wait)

        cell.schedule(0, wait)

    def begin(self, fault: FaultConfig, now_ns: int) -> None:
        """Let a fault happen now; tests and campaigns call it directly as well."""
        undo = self._start(fault, now_ns)
        if fault.duration_s is not None and undo is not None:
            self._cell.schedule(now_ns + round(fault.duration_s * _NS), undo)

    def _start(self, fault: FaultConfig, now_ns: int) -> Callable[[int], None] | None:
        kind = fault.kind
        if kind in FRAME_FAULTS:
            active = FrameFault(fault, self._fault_ids(fault), fault.count)
            self.frames.append(active)
            return lambda _now: self.frames.remove(active)
        if kind == "bus_off" and fault.axis is None:
            return self._set(self._cell, "master_off", True)
        drive = self._cell.drive(fault.axis)
        node = drive.node
        if kind in ("node_silent", "bus_off"):
            undo = self._set(node, "silent", True, then=self._cell.rewire)
            if kind == "bus_off":  # a node knows that it is bus-off; one with a pulled cable does not
                drive.connection_lost(now_ns)
            return undo
        if kind == "node_reset":
            node.power_on(now_ns)
        elif kind == "emcy":
            node.emergency(fault.code, 0x01, length=fault.length)
        elif kind == "drive_fault":
            drive.fail(fault.code, 0x01, now_ns)
        elif kind == "brake_stuck":
            return self._set(drive.brake, "stuck", True)
        elif kind in _SWITCHES:
            name, value = _SWITCHES[kind]
            return self._set(drive, name, value(fault))
        else:
            return self._disturb_motor(fault, drive, now_ns)
        return None

    @staticmethod
    def _set(
        target: object, name: str, value: object, then: Callable[[], None] = lambda: None
    ) -> Callable[[int], None]:
        before = getattr(target, name)
        setattr(target, name, value)
        then()

        def undo(_now: int) -> None:
            setattr(target, name, before)
            then()

        return undo

    def _disturb_motor(self, fault: FaultConfig, drive: Drive, now_ns: int) -> Callable[[int], None] | None:
        self._cell.plant.advance_to(now_ns)
        command = self._cell.plant.command[drive.row]
        kind = fault.kind
        if kind == "push":
            motor = int(self._cell.plant.structure.motors[drive.row])
            self._cell.plant.external[motor] += fault.torque

            def let_go(at_ns: int) -> None:
                self._cell.plant.advance_to(at_ns)
                self._cell.plant.external[motor] -= fault.torque

            return let_go
        if kind == "encoder_jump":
            column, value = kernel.ENCODER_OFFSET, command[kernel.ENCODER_OFFSET]
            value += drive.direction * fault.counts / drive.counts_per_unit
        elif kind == "encoder_stuck":
            command[kernel.STUCK_AT] = (
                drive.measured[3] / drive.counts_per_unit - command[kernel.ENCODER_OFFSET]
            )
            column, value = kernel.STUCK, 1.0
        elif kind == "sign_flip":
            column = kernel.TORQUE_GAIN if fault.signal == "torque" else kernel.ENCODER_SIGN
            value = -command[column]
        else:
            column, value = kernel.SATURATION, fault.limit
        before = float(command[column])
        command[column] = value

        def undo(at_ns: int) -> None:
            self._cell.plant.advance_to(at_ns)
            command[column] = before

        return undo

    def _fault_ids(self, fault: FaultConfig) -> frozenset[int] | None:
        if fault.can_ids is not None:
            return frozenset(fault.can_ids)
        if fault.axis is None:
            return None
        node = self._cell.drive(fault.axis).node.node_id
        return frozenset(base + node for base in range(0x80, 0x780, 0x80))
