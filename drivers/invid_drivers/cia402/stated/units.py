"""Counts and thousandths to radians (metres) and newton metres (newtons)."""

from __future__ import annotations

import math
from dataclasses import dataclass

WHOLE = 1 << 32
"""Counts of the circle of INTEGER32."""
LEAST_COUNTS = 6
"""Counts of a turn that the coarsest feedback has: the six states of three Hall sensors."""


@dataclass(frozen=True)
class Scaling:
    """Factors of one axis.

    Attributes
    ----------
    position_per_count
        Motor position of one count of 0x6064 [rad or m], > 0.
    rated_torque
        0x6076 or the config's [N·m or N], > 0.
    direction
        +1 or −1: the sign of both position and torque in the recording.
    """

    position_per_count: float
    rated_torque: float
    direction: int = 1

    def torque(self, permille: int) -> float:
        """0x6077 to torque."""
        return self.direction * self.rated_torque * permille / 1000.0

    def most_permille(self, torque: float) -> int:
        """Whole thousandths that are not more than a torque limit, at least one."""
        return max(1, min(32767, math.floor(torque / self.rated_torque * 1000.0 + 1e-9)))


def position_per_count(increments: int, revolutions: int, *, linear: bool = False) -> float | None:
    """Motor position of one count [rad or m] where ``increments`` of them are so many turns of the motor.

    ``None`` where the objects say nothing: zero, or fewer than ``LEAST_COUNTS`` a turn, as in drives that
    come with 1 and 1. For a linear axis a revolution stands for a metre, as the encoder's increments do.
    """
    if revolutions <= 0 or increments < LEAST_COUNTS * revolutions:
        return None
    per_turn = 1.0 if linear else 2.0 * math.pi
    return per_turn * revolutions / increments


def wrapped_difference(counts: int, since: int, span: int = WHOLE) -> int:
    """``counts − since`` on a circle of so many counts: 0x6064 may wrap around, at 0x607B or at 32 bits."""
    return (counts - since + span // 2) % span - span // 2
