"""Which axes without a load run away or fall silent while the drives do their quick stop."""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.sweep.bounds import has_leapt
from invid.sweep.ports import Sample

RUNAWAY_GROWTH, RUNAWAY_SHARE = 1.2, 0.02
"""A quick stop only slows down. Above 1.2 times the speed at its start, and 2 % of the permitted speed, it
does the opposite (empirical)."""
NOISE_COUNTS = 4
"""Counts in a cycle that are no motion: both ends of a step, each with its last digit."""


class RunawayGuard:
    """Compares the speed during a quick stop with the speed at its start."""

    def __init__(self, config: CellConfig, counts: Sequence[float]) -> None:
        """``counts``: position of an encoder count."""
        self._least = [RUNAWAY_SHARE * a.limits.velocity for a in config.axes]
        for i, count in enumerate(counts):
            self._least[i] = max(self._least[i], NOISE_COUNTS * abs(count) / config.bus.cycle_s)
        count = len(config.axes)
        self._before: list[tuple[float, float] | None] = [None] * count
        self._entry = [-1.0] * count
        self._quiet = [0] * count
        self._axes = config.axes
        self._counts = counts
        self.leapt: set[int] = set()
        """Axes whose encoders went further between two samples than an axis can."""

    def silent(self, sample: Sample) -> list[int]:
        """Axes that have not answered for three samples."""
        for i, fresh in enumerate(sample.fresh):
            self._quiet[i] = 0 if fresh else self._quiet[i] + 1
        return [i for i, n in enumerate(self._quiet) if n >= 3]

    def faster(self, sample: Sample) -> list[int]:
        """Axes that are faster than a quick stop could make them."""
        found: list[int] = []
        for i, fresh in enumerate(sample.fresh):
            if not fresh:
                continue
            before, self._before[i] = self._before[i], (sample.time, sample.position[i])
            if before is None or sample.time <= before[0]:
                continue
            way, seconds = abs(sample.position[i] - before[1]), sample.time - before[0]
            if has_leapt(way, seconds, self._axes[i].limits.velocity, abs(self._counts[i])):
                self.leapt.add(i)
            speed = way / seconds
            if self._entry[i] < 0:
                self._entry[i] = speed
            if speed > RUNAWAY_GROWTH * self._entry[i] + self._least[i]:
                found.append(i)
        return found
