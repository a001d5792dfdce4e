"""The CiA 402 power drive state machine (IEC 61800-7-201) as a pure function.

Transition numbers are the standard's. Option codes and stopping ramps are the node's business: where
a transition waits for a ramp, the node enters the returned state when the ramp has ended.
"""

from __future__ import annotations

from enum import IntEnum
from types import MappingProxyType

from invid_drivers.cia402.states import DriveState


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
