"""The limits a simulated drive watches by itself, read from its object dictionary."""

from __future__ import annotations

import math
from dataclasses import dataclass

from invid_drivers.simulated.object_dictionary import ObjectDictionary

_UNLIMITED = 0xFFFFFFFF
_LOWEST, _HIGHEST = -(1 << 31), (1 << 31) - 1


@dataclass(frozen=True)
class Limits:
    """Limits in counts and counts per second; infinite where the drive has or was given none."""

    fastest: float
    low: int
    high: int
    window: float
    """Following-error window."""
    window_ns: int
    """How long the following error may be outside it."""

    @classmethod
    def of(cls, od: ObjectDictionary, counts_per_rev: float, *, rpm: bool = False) -> Limits:
        """Read 0x607F, 0x6080, 0x607D, 0x6065 and 0x6066; ``counts_per_rev`` 0 for a linear axis.

        ``rpm``: 0x607F counts revolutions per minute, as some vendors have it.
        """
        profile = od.number(0x607F, missing=_UNLIMITED)
        fastest = math.inf if profile == _UNLIMITED else float(profile)
        if rpm and counts_per_rev:
            fastest *= counts_per_rev / 60.0
        most = od.number(0x6080, missing=_UNLIMITED)
        if most != _UNLIMITED and counts_per_rev:
            fastest = min(fastest, most * counts_per_rev / 60.0)
        low, high = od.number(0x607D, 1, _LOWEST), od.number(0x607D, 2, _HIGHEST)
        if low >= high:  # both zero, as some drives come: no limit
            low, high = _LOWEST, _HIGHEST
        window = od.number(0x6065, missing=_UNLIMITED)
        return cls(
            fastest,
            low,
            high,
            math.inf if window == _UNLIMITED else float(window),
            od.number(0x6066, missing=0) * 1_000_000,
        )
