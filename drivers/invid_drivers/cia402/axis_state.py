"""The states of an axis and the one table of what each means: what is sent, what ends it, what follows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from invid.sweep.ports import Mode


class AxisState(Enum):
    """Where an axis is between two powers off."""

    OFF = "without torque"
    ENABLING = "being enabled"
    HELD = "held by its drive"
    LED = "led by this master"
    SWITCHING = "without power for another mode"
    STOPPING = "brought to rest"
    PARKING = "in a quick stop"
    STANDS = "held by its drive in quick stop active"
    BRAKING = "handed to its brake"
    BRAKED = "held by its brake"
    CATCHING = "let go, and caught"
    CAUGHT = "held again until it is supported"
    SLOWING = "slowed by torque of the other sign"
    LETTING_GO = "being switched off"
    UNHEARD = "not obeying"
    FAULT = "without torque, not by this master"
    LOST = "held by nothing that was seen"


class Command(Enum):
    """What the controlword of a state asks for."""

    DISABLE = auto()
    """Voltage off."""
    STAND_BY = auto()
    """Torque off, power stage on: a brake closes, and torque is back in two cycles."""
    QUICK_STOP = auto()
    ENABLE = auto()
    """Towards operation enabled, one step a cycle."""


class Fact(Enum):
    """What is seen of an axis."""

    ENABLED = "enabled"
    MODE = "in its mode"
    STANDING = "standing"
    STOPPED = "in quick stop active"
    UNPOWERED = "without power"
    SUPPORTED = "supported"


@dataclass(frozen=True)
class Rule:
    """What a state sends, by which facts it ends and in which state, and what follows from trouble."""

    command: Command
    mode: Mode | None = None
    """Asked for; ``None``: whatever it is in."""
    done: tuple[Fact, ...] = ()
    then: AxisState | None = None
    within_s: float = math.inf
    """Deadline of the facts; a drive that says it is changing its mode has ``CHANGING_S`` more."""
    late: AxisState | None = None
    falls: AxisState | None = None
    """Where an axis goes that does not stand, or gets faster; ``None``: nothing can be done about it."""
    is_final: bool = False
    """The way out may end here."""


S, F = AxisState, Fact
NEXT = S.LOST
"""In the columns ``late`` and ``falls``: the best means that was not tried yet; ``LOST`` where there is
none."""

ENABLE_S = 3.0
"""Longest way to operation enabled: brakes take a few hundred milliseconds to open."""
CHANGING_S = 10.0
"""Longest change of mode where the drive says meanwhile that it is in none (one report has 4 s)."""
REST_S = 3.0
"""Longest way from being led to standing in position mode."""
QUICK_STOP_S, LONGEST_RAMP_S = 1.0, 10.0
"""Longest quick stop where the drive's ramp is not longer; however gentle that is, an axis still moving then
is let go, or held."""
BRAKE_S = 2.5
"""Longest time until a brake has closed."""
CATCH_S = 3.0
"""Longest way back to being held; one that has left its window by then is held by nothing."""
SUPPORT_S = 30.0
"""Longest wait for a person to support a load that its drive let go."""
SLOW_S = 0.3
"""An axis whose torque has turned is slowed so long: 20 N·m stop 1 kg·m² from 3 rad/s in half of it. A load
without a brake sinks, as slowly as damping lets it, for ``SUPPORT_S``, or until it rests on something."""
OFF_S = 2.0
"""From voltage off to standing still."""
TELL_S = 5.0
"""A drive that does not obey is told, and asked, by SDO so long."""
UNHEARD_S = 1.0
"""What its drive holds is final while that is heard of; after so long without an answer it counts as lost.
A drive that starts anew says so sooner."""

RULES: dict[AxisState, Rule] = {
    S.OFF: Rule(Command.DISABLE, falls=S.CATCHING, is_final=True),
    S.ENABLING: Rule(Command.ENABLE, Mode.HOLD, (F.ENABLED, F.MODE), S.HELD, ENABLE_S, S.PARKING, NEXT),
    S.HELD: Rule(Command.ENABLE, Mode.HOLD, falls=NEXT),
    S.LED: Rule(Command.ENABLE, Mode.TORQUE, falls=NEXT),
    S.SWITCHING: Rule(Command.DISABLE, None, (F.MODE,), S.ENABLING, CHANGING_S, S.FAULT, NEXT),
    S.STOPPING: Rule(
        Command.ENABLE, Mode.HOLD, (F.ENABLED, F.MODE, F.STANDING), S.HELD, REST_S, S.PARKING, S.PARKING
    ),
    S.PARKING: Rule(Command.QUICK_STOP, None, (F.STOPPED, F.STANDING), S.STANDS, LONGEST_RAMP_S, NEXT, NEXT),
    S.STANDS: Rule(Command.QUICK_STOP, falls=NEXT, is_final=True),
    S.BRAKING: Rule(Command.STAND_BY, None, (F.UNPOWERED, F.STANDING), S.BRAKED, BRAKE_S, NEXT, NEXT),
    S.BRAKED: Rule(Command.DISABLE, falls=NEXT, is_final=True),
    S.CATCHING: Rule(
        Command.ENABLE, Mode.HOLD, (F.ENABLED, F.MODE, F.STANDING), S.CAUGHT, CATCH_S, NEXT, None
    ),
    S.CAUGHT: Rule(Command.ENABLE, Mode.HOLD, (F.SUPPORTED,), S.PARKING, SUPPORT_S, S.PARKING, NEXT),
    S.SLOWING: Rule(Command.ENABLE, Mode.TORQUE, (F.STANDING,), S.LETTING_GO, SLOW_S, S.LETTING_GO),
    S.LETTING_GO: Rule(Command.DISABLE, None, (F.UNPOWERED, F.STANDING), S.OFF, OFF_S, S.UNHEARD, S.CATCHING),
    S.UNHEARD: Rule(Command.DISABLE, None, (F.UNPOWERED,), S.OFF, TELL_S, S.UNHEARD, None),
    S.FAULT: Rule(Command.DISABLE, is_final=True),
    S.LOST: Rule(Command.QUICK_STOP, is_final=True),
}
"""The table."""


def longest_way_out() -> float:
    """Longest time from a wish to end to final states of all axes [s], by the deadlines of the table.

    Axes go their ways at the same time. The longest is a led axis that comes to rest, is let go by its quick
    stop, caught, held until it is supported, stopped again and weighed.
    """
    ways = (S.STOPPING, S.PARKING, S.BRAKING, S.CATCHING, S.CAUGHT, S.PARKING, S.LETTING_GO, S.UNHEARD)
    return sum(RULES[s].within_s for s in ways) + CHANGING_S + UNHEARD_S
