"""Whether axes stand: by how far each has gone since it was last seen to move."""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.sweep.ports import Sample

STAND_S = 0.3
"""An axis stands that has stayed within its tolerance for so long: one that falls with 0.02 rad/s² leaves
that of a window of 0.5 rad by then."""
STILL_COUNTS = 8
"""Counts that are no motion: what an encoder shows at rest, and its last digits."""
STILL_SHARE = 0.002
"""Of the window."""


def tolerances(config: CellConfig, counts: Sequence[float], share: float = STILL_SHARE) -> list[float]:
    """How far each axis may go and still stand [rad or m]: a ``share`` of its window, or some ``counts``."""
    return [
        max(STILL_COUNTS * abs(count), share * axis.limits.position)
        for count, axis in zip(counts, config.axes, strict=True)
    ]


class Standstill:
    """Axes of one cell, looked at sample by sample; ``within``: tolerance of each axis [rad or m]."""

    def __init__(self, within: Sequence[float]) -> None:
        self._within = within
        self._since: list[tuple[float, float] | None] = [None] * len(within)
        self._stands = [False] * len(within)

    def all(self, sample: Sample, axes: Sequence[int]) -> bool:
        """Whether all of these axes stand; each is judged by answers of its own."""
        for i in axes:
            if not sample.fresh[i]:
                continue
            since, place = self._since[i], sample.position[i]
            if since is None or abs(place - since[1]) > self._within[i]:
                self._since[i], self._stands[i] = (sample.time, place), False
            else:
                self._stands[i] = sample.time - since[0] >= STAND_S
        return all(self._stands[i] for i in axes)

    def stands(self, axis: int) -> bool:
        """Whether an axis stood when it was last heard."""
        return self._stands[axis]

    def forget(self, axis: int) -> None:
        """Look anew: what held it until now holds it no longer."""
        self._since[axis], self._stands[axis] = None, False
