"""The clock of a budget: processor time of a run and at least half of what went by."""

from __future__ import annotations

import os
import time

MOST_WALL = 2.0
"""Seconds that may go by for each second of a budget: on a busy machine a run gets a part of a core only, and
whoever waits for it waits no longer than that."""


class RunClock:
    """Seconds since it was made: of the processor; ``MOST_WALL`` seconds
    that go by count as one at least."""

    def __init__(self) -> None:
        self._began, self._used = time.monotonic(), _process_seconds()

    def __call__(self) -> float:
        return max(_process_seconds() - self._used, (time.monotonic() - self._began) / MOST_WALL)


def _process_seconds() -> float:
    """Processor seconds of this process and of those that it has waited for."""
    return sum(os.times()[:4])


__all__ = ["MOST_WALL", "RunClock"]
