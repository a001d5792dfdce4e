"""What a drive's manual says about stopping, holding and limits: the questions, and how an unknown counts."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


class Answer(enum.Enum):
    """An answer from a manual. Nothing is assumed of ``UNKNOWN`` but the worst.

    Ask ``certain`` of what protects (does the drive enforce its limit?) and ``possible`` of what endangers
    (may the torque limit lengthen the ramp?): both then count an unknown as the worst.
    """

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"

    @property
    def certain(self) -> bool:
        """Yes, and a source says so."""
        return self is Answer.YES

    @property
    def possible(self) -> bool:
        """Not excluded by a source."""
        return self is not Answer.NO


YES, NO, UNKNOWN = Answer.YES, Answer.NO, Answer.UNKNOWN

RampUnit = Literal["rpm/s", "position units/s²", "unknown"]
"""Unit of 0x6085. Unknown: its value says nothing about how the axis stops."""

Reaction = Literal["quick stop", "voltage off", "nothing", "unknown"]
"""What a drive does by itself. Unknown: nothing, then voltage off, whichever is worse for the axis."""

BrakeClosing = Literal["at standstill", "when disabled", "unknown"]
"""When the drive closes its brake. Unknown: too late to hold a loaded axis."""


@dataclass(frozen=True, kw_only=True)
class Manual:
    """What was read of one drive. ``sources`` names document and revision for each field that is known.

    Attributes
    ----------
    cyclic_torque
        Cyclic synchronous torque (mode 10).
    torque_offset
        0x60B2 adds to the torque in cyclic synchronous position.
    enforces_torque_limit
        0x6072 (or the vendor's own torque limit) acts in a torque mode.
    quick_stop_default
        0x605A as delivered; ``None`` where the object is missing or its value is unknown.
    quick_stop_values
        What 0x605A takes; empty where unknown.
    quick_stop_ramp_unit
        Unit of 0x6085.
    ramp_capped_by_torque_limit
        0x6072 bounds the torque of the quick stop, so that the ramp of 0x6085 may not be reached.
    heartbeat_lost
        What the drive does where the heartbeat it watches is missing, with 0x6007 as delivered.
    rpdo_event_timer
        0x1400:5 watches for a missing RPDO.
    sync_supervision
        The drive notices missing SYNC (0x1006).
    brake_closes, torque_until_brake_closed
        When the brake is closed, and whether the motor holds until it has closed.
    position_before_gear
        0x6064 counts at the motor, before the gear.
    """

    cyclic_torque: Answer = UNKNOWN
    torque_offset: Answer = UNKNOWN
    enforces_torque_limit: Answer = UNKNOWN
    quick_stop_default: int | None = None
    quick_stop_values: tuple[int, ...] = ()
    quick_stop_ramp_unit: RampUnit = "unknown"
    ramp_capped_by_torque_limit: Answer = UNKNOWN
    heartbeat_lost: Reaction = "unknown"
    rpdo_event_timer: Answer = UNKNOWN
    sync_supervision: Answer = UNKNOWN
    brake_closes: BrakeClosing = "unknown"
    torque_until_brake_closed: Answer = UNKNOWN
    position_before_gear: Answer = UNKNOWN
    sources: Mapping[str, str] = field(default_factory=dict)
