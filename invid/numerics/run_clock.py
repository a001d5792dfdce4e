"""The clock of a budget: processor time of a run, its helpers included, and at least half of what went by."""

from __future__ import annotations

import os
import time

MOST_WALL = 2.0
"""Seconds that may go by for each second of a budget: on a busy machine a run gets a part of a core only, and
whoever waits for it waits no longer than that."""


class RunClock:
    """Seconds since it was made: of the processor, in this process and its helpers; ``MOST_WALL`` seconds
    that go by count as one at least."""

    def __init__(self) -> None:
        self._began, self._used = time.monotonic(), _process_seconds()
        self._before, self._working = 0.0, 1

    def __call__(self) -> float:
        used = self._before + self._working * (_process_seconds() - self._used)
        return max(used, (time.monotonic() - self._began) / MOST_WALL)

    def begin_helpers(self, processes: int) -> None:
        """Count from here on so many processes, this one among them: call it before the others are forked."""
        self._before += _process_seconds() - self._used
        self._used, self._working = _process_seconds(), processes

    def enter_helper(self) -> None:
        """Start the clock of a forked helper, whose own processor time begins at zero."""
        self._used = _process_seconds()

    def end_helpers(self) -> None:
        """Count one process again: the helpers have ended, and the system knows what they used."""
        self._working = 1


def _process_seconds() -> float:
    """Processor seconds of this process and of the helpers that it has waited for."""
    return sum(os.times()[:4])


__all__ = ["MOST_WALL", "RunClock"]
