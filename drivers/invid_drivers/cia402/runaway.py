"""Which axes run away or fall silent while the drives do their quick stop."""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.sweep.ports import Sample

RUNAWAY_GROWTH, RUNAWAY_SHARE = 1.2, 0.02
"""A quick stop only slows down. Above 1.2 times the speed at its start, and 2 % of the permitted speed, it
does the opposite (empirical)."""
NOISE_COUNTS = 4
"""Counts in a cycle that are no motion: both ends of a step, each with its last digit."""
AT_LIMIT = 0.9
"""Share of the torque limit that is all of it, with the noise of 0x6077."""
LOADED_RUNAWAYS = 5
"""An axis that its drive must hold is cut off only after five samples in a row of growing speed."""


class RunawayGuard:
    """Compares the speed during a quick stop with the speed at its start."""

    def __init__(
        self,
        config: CellConfig,
        held: Sequence[bool],
        counts: Sequence[float] = (),
        permitted: Sequence[float] = (),
    ) -> None:
        """``counts``: position of an encoder count; ``permitted``: speed of each axis, within its limit."""
        self._permitted = list(permitted)
        self._torque = [AT_LIMIT * a.limits.torque for a in config.axes]
        # A loaded axis without brake falls when it is let go: only a certain runaway is worse. A person who
        # pushes makes it faster too, but not faster than it may be.
        self._least = [
            (1.0 if stays and a.brake != "drive" else RUNAWAY_SHARE) * a.limits.velocity
            for a, stays in zip(config.axes, held, strict=True)
        ]
        for i, count in enumerate(counts):
            self._least[i] = max(self._least[i], NOISE_COUNTS * abs(count) / config.bus.cycle_s)
        self._needed = [LOADED_RUNAWAYS if stays else 1 for stays in held]
        count = len(config.axes)
        self._before: list[tuple[float, float] | None] = [None] * count
        self._entry = [-1.0] * count
        self._last = [0.0] * count
        self._seen = [0] * count
        self._quiet = [0] * count

    def silent(self, sample: Sample) -> list[int]:
        """Axes that have not answered for three samples."""
        for i, fresh in enumerate(sample.fresh):
            self._quiet[i] = 0 if fresh else self._quiet[i] + 1
        return [i for i, n in enumerate(self._quiet) if n >= 3]

    def faster(self, sample: Sample) -> list[int]:
        """Axes that are faster than a quick stop could make them, as often in a row as they need to be."""
        found: list[int] = []
        for i, fresh in enumerate(sample.fresh):
            if not fresh:
                continue
            before, self._before[i] = self._before[i], (sample.time, sample.position[i])
            if before is None or sample.time <= before[0]:
                continue
            speed = abs(sample.position[i] - before[1]) / (sample.time - before[0])
            if self._entry[i] < 0:
                self._entry[i] = speed
            fast = speed > RUNAWAY_GROWTH * self._entry[i] + self._least[i]
            if self._permitted and abs(sample.torque[i]) >= self._torque[i]:
                # all its torque does not slow it down: what drags it is stronger, or its own drive
                fast = fast or speed > RUNAWAY_GROWTH * self._entry[i] + self._permitted[i]
            if self._needed[i] > 1:
                fast = fast and speed > self._last[i]
            self._last[i] = speed
            self._seen[i] = self._seen[i] + 1 if fast else 0
            if self._seen[i] >= self._needed[i]:
                found.append(i)
        return found
