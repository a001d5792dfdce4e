"""The CiA 402 power drive state machine (IEC 61800-7-201): as its master sees it, and as a drive has it.

Transition numbers are the standard's. Option codes and stopping ramps are the drive's business: where a
transition waits for a ramp, it enters the state when the ramp has ended.
"""

from __future__ import annotations

from enum import IntEnum
from types import MappingProxyType
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


# --- as a drive has it ---
class Command(IntEnum):
    """Device control commands: patterns of the controlword."""

    NONE = 0
    SHUTDOWN = 1
    SWITCH_ON = 2
    ENABLE_OPERATION = 3
    DISABLE_VOLTAGE = 4
    QUICK_STOP = 5
    FAULT_RESET = 6


def command_of(controlword: int, previous: int) -> Command:
    """The command in a controlword; a fault reset is a rising edge of bit 7 and masks the rest."""
    if controlword & 0x80:
        return Command.NONE if previous & 0x80 else Command.FAULT_RESET
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if controlword & 0x08 else Command.SWITCH_ON


_S, _C = DriveState, Command

TRANSITIONS: MappingProxyType[tuple[DriveState, Command], tuple[int, DriveState]] = MappingProxyType(
    {
        (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): (2, _S.READY_TO_SWITCH_ON),
        (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): (3, _S.SWITCHED_ON),
        # "switch on and enable operation": 3, then 4 of itself
        (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): (3, _S.SWITCHED_ON),
        (_S.SWITCHED_ON, _C.ENABLE_OPERATION): (4, _S.OPERATION_ENABLED),
        (_S.OPERATION_ENABLED, _C.SWITCH_ON): (5, _S.SWITCHED_ON),
        (_S.SWITCHED_ON, _C.SHUTDOWN): (6, _S.READY_TO_SWITCH_ON),
        (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): (7, _S.SWITCH_ON_DISABLED),
        (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): (7, _S.SWITCH_ON_DISABLED),
        (_S.OPERATION_ENABLED, _C.SHUTDOWN): (8, _S.READY_TO_SWITCH_ON),
        (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): (9, _S.SWITCH_ON_DISABLED),
        (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): (10, _S.SWITCH_ON_DISABLED),
        (_S.SWITCHED_ON, _C.QUICK_STOP): (10, _S.SWITCH_ON_DISABLED),
        (_S.OPERATION_ENABLED, _C.QUICK_STOP): (11, _S.QUICK_STOP_ACTIVE),
        (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): (12, _S.SWITCH_ON_DISABLED),
        (_S.FAULT, _C.FAULT_RESET): (15, _S.SWITCH_ON_DISABLED),
        (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): (16, _S.OPERATION_ENABLED),
    }
)
"""Number and target of the transition that a command causes in a state; none: no change."""
