"""The CiA 402 power drive state machine as its master sees it."""

from __future__ import annotations

from enum import IntEnum
from typing import assert_never


class DriveState(IntEnum):
    """States of IEC 61800-7-201; the value is the statusword's state bits (mask 0x006F)."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08

    @property
    def words(self) -> str:
        """Name of the state for messages."""
        return self.name.replace("_", " ").lower()


class OperationMode(IntEnum):
    """Modes of operation, as in 0x6060 and 0x6061."""

    PROFILE_TORQUE = 4
    CYCLIC_POSITION = 8
    CYCLIC_TORQUE = 10

    @property
    def supported_bit(self) -> int:
        """Bit of the mode in 0x6502."""
        return 1 << (self - 1)


SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
FAULT_RESET = 0x0080


_BY_BITS = {int(state): state for state in DriveState}


def state_of(statusword: int) -> DriveState:
    """The state in a statusword (bits 0–3, 5, 6).

    Bit 5 (quick stop) is "don't care" in the states in which the standard leaves it open.
    """
    loosely = _BY_BITS.get(statusword & 0x4F, DriveState.NOT_READY_TO_SWITCH_ON)
    return _BY_BITS.get(statusword & 0x6F, loosely)


def towards_enabled(state: DriveState) -> int:
    """Controlword of the next step towards operation enabled; a fault stays: a reset is a person's choice."""
    match state:
        case DriveState.NOT_READY_TO_SWITCH_ON | DriveState.FAULT_REACTION_ACTIVE | DriveState.FAULT:
            return DISABLE_VOLTAGE
        case DriveState.SWITCH_ON_DISABLED:
            return SHUTDOWN
        case DriveState.READY_TO_SWITCH_ON:
            return SWITCH_ON
        case DriveState.SWITCHED_ON | DriveState.OPERATION_ENABLED:
            return ENABLE_OPERATION
        case DriveState.QUICK_STOP_ACTIVE:
            # Only by way of switch on disabled: resuming from a quick stop would move without a check.
            return DISABLE_VOLTAGE
        case _:
            assert_never(state)


def is_energised(state: DriveState) -> bool:
    """Whether the power stage may still put torque on the motor."""
    match state:
        case DriveState.OPERATION_ENABLED | DriveState.QUICK_STOP_ACTIVE | DriveState.FAULT_REACTION_ACTIVE:
            return True
        case (
            DriveState.NOT_READY_TO_SWITCH_ON
            | DriveState.SWITCH_ON_DISABLED
            | DriveState.READY_TO_SWITCH_ON
            | DriveState.SWITCHED_ON
            | DriveState.FAULT
        ):
            return False
        case _:
            assert_never(state)
