"""Time left as it is told: it never rises, and where it has run out nothing is promised."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

EVERY_S = 1.0
SLOWER = 0.5
"""Pace at which time left is counted while more is expected than was told (a convention)."""


class Countdown:
    """Seconds left, by estimates that may change: down at once, never up; ``None`` where none is known."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told: tuple[float, float] | None = None

    def left(self, estimate: float | None) -> float | None:
        """Return what is told now."""
        now = self._clock()
        if self._told is None:
            if estimate is None:
                return None
            self._told = now, max(estimate, 0.0)
            return self._told[1]
        then, before = self._told
        passed = now - then
        told = before - passed
        if estimate is None or estimate > told:
            told = min(before - SLOWER * passed, told if estimate is None else max(estimate, 0.0))
        else:
            told = max(estimate, 0.0)
        self._told = now, max(told, 0.0)
        return told if told > 0.0 else None


class Ticker:
    """What tells how far it is every second, beside what else makes it tell."""

    def __init__(self) -> None:
        self._over = threading.Event()

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """Context manager in which a thread reports progress every second."""
        ticker = threading.Thread(target=self._tick, name="progress", daemon=True)
        ticker.start()
        try:
            yield
        finally:
            self._over.set()
            ticker.join()

    def _tick(self) -> None:
        while not self._over.wait(EVERY_S):
            self.say()

    def say(self, *, always: bool = False) -> None:
        """Report how far it is now."""
        raise NotImplementedError
