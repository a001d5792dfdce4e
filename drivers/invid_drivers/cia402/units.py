"""Counts and thousandths to radians (metres) and newton metres (newtons)."""

from __future__ import annotations

import math
from dataclasses import dataclass


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

    def position(self, counts: int) -> float:
        """Counts of 0x6064 to position."""
        return self.direction * self.position_per_count * counts

    def counts(self, position: float) -> int:
        """Position to counts, rounded."""
        return round(self.direction * position / self.position_per_count)

    def torque(self, permille: int) -> float:
        """0x6077 to torque."""
        return self.direction * self.rated_torque * permille / 1000.0

    def permille(self, torque: float) -> int:
        """Torque to 0x6071, rounded to whole thousandths and to the type's range."""
        return max(-32768, min(32767, round(self.direction * torque / self.rated_torque * 1000.0)))


def position_per_count(
    increments: int, revolutions: int, *, linear: bool = False, feed: int = 0, feed_revolutions: int = 0
) -> float | None:
    """Motor position of one count from 0x608F (and 0x6092 where it rescales 0x6064).

    ``None`` where the objects say nothing (zero). For a linear axis a revolution stands for a metre,
    as the encoder's increments do.
    """
    if feed > 0 and feed_revolutions > 0:
        increments, revolutions = feed, feed_revolutions
    if increments <= 0 or revolutions <= 0:
        return None
    per_turn = 1.0 if linear else 2.0 * math.pi
    return per_turn * revolutions / increments


def wrapped_difference(counts: int, since: int) -> int:
    """``counts − since`` on the circle of INTEGER32: 0x6064 may wrap around."""
    return (counts - since + 0x80000000 & 0xFFFFFFFF) - 0x80000000
