"""Faults that a cell's configuration injects: when, where, what.

A fault begins ``at_s`` seconds after the cell starts, or ``after_s`` seconds after an axis first
reaches a state of the CiA 402 state machine, and lasts ``duration_s`` (default: for good). Faults on
frames are drawn from the cell's seed, so that a run repeats.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from pydantic import Field, model_validator

from invid.config.experiments import Strict

FrameFaultKind = Literal["drop", "delay", "duplicate", "corrupt"]
DriveFaultKind = Literal[
    "node_reset", "node_silent", "bus_off", "emcy", "drive_fault", "ignore_quick_stop", "ignore_controlword",
    "encoder_jump", "encoder_stuck", "sign_flip", "brake_stuck", "torque_saturation", "push", "statusword",
    "mode_display", "torque_display", "torque_scale", "ignore_target",
]  # fmt: skip
FRAME_FAULTS: tuple[str, ...] = get_args(FrameFaultKind)
DRIVE_FAULTS: tuple[str, ...] = get_args(DriveFaultKind)


class FaultConfig(Strict):
    """One injected fault; the fields that a kind does not use must be left out."""

    kind: FrameFaultKind | DriveFaultKind
    axis: str | None = None
    """None: the master's own port for bus_off, every frame for faults on frames."""
    at_s: float | None = Field(default=None, ge=0)
    at_state: (
        Literal["ready_to_switch_on", "switched_on", "operation_enabled", "quick_stop_active", "fault"] | None
    ) = None
    after_s: float = Field(default=0.0, ge=0)
    duration_s: float | None = Field(default=None, gt=0)
    # faults on frames
    can_ids: list[int] | None = None
    """11-bit identifiers; None: all of the axis, or all."""
    rate: float = Field(default=1.0, ge=0, le=1)
    count: int | None = Field(default=None, ge=1)
    """Stop after so many frames (a burst)."""
    delay_s: float = Field(default=0.001, gt=0)
    # faults of drives
    code: int = Field(default=0x2310, ge=0, le=0xFFFF)
    length: int = Field(default=8, ge=1, le=8)
    counts: int = 0
    signal: Literal["torque", "encoder"] = "torque"
    limit: float = Field(default=0.0, ge=0, validation_alias="limit_Nm")
    torque: float = Field(default=0.0, validation_alias="torque_Nm")
    value: int = Field(default=0, ge=-32768, le=0xFFFF)
    gain: float = 1.0
    """0x6077 over the torque."""

    @model_validator(mode="after")
    def _when_and_where(self) -> FaultConfig:
        if (self.at_s is None) == (self.at_state is None):
            raise ValueError(f"fault {self.kind}: give either at_s or at_state")
        needs_axis = self.kind in DRIVE_FAULTS and self.kind != "bus_off"
        if (needs_axis or self.at_state is not None) and self.axis is None:
            raise ValueError(f"fault {self.kind}: give the axis")
        if self.kind == "mode_display" and not -128 <= self.value <= 127:
            raise ValueError(f"fault mode_display: value {self.value} is no mode; it must be -128 to 127")
        return self


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
