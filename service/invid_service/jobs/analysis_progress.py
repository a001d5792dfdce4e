"""How far an analysis is and how long it will take: by what it tells itself, and by what it took before."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

BEGINS, ENDS = 0.8, 0.99
"""Shares of a whole run between which the analysis lies; motion comes before it."""
STAGES = {
    "reading the recording": (0.0, 0.03),
    "identifying": (0.03, 0.25),
    "diagnosing": (0.25, 0.93),
    "writing the report": (0.93, 1.0),
}
"""Shares of the analysis. Empirical: the case study and cells of one to six axes (``bench_service.py``)."""
EVERY_S = 1.0
OVERDUE = 0.1
"""What takes longer than it did before still takes a tenth of what it took so far."""
UNKNOWN_S = 40.0
"""Of the first run of a cell, until the analysis itself says more: the case study on two cores."""

Tell = Callable[..., None]


class AnalysisProgress:
    """Tells every second, and whenever the analysis says what it weighs, until closed.

    Parameters
    ----------
    tell
        Called with ``fraction``, ``phase`` and the keywords ``axis``, ``cause``, ``eta_s``, ``always`` (never
        to be left out).
    expected_s
        What the analysis of such a run took before [s]; ``None``: it is the first.
    """

    def __init__(
        self, tell: Tell, expected_s: float | None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell, self._clock = tell, clock
        self._expected = expected_s or UNKNOWN_S
        self._began = clock()
        self._low, self._high = 0.0, 1.0
        self._share = 0.0
        self._left: tuple[float, float] | None = None
        """When the analysis said how long it still takes, and what it said."""
        self._phase, self._axis, self._cause = "", None, None
        self._lock = threading.Lock()
        self._over = threading.Event()

    @property
    def elapsed_s(self) -> float:
        """Since the analysis began [s]."""
        return self._clock() - self._began

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """Inside, progress is told every second by a thread of its own."""
        ticker = threading.Thread(target=self._tick, name="analysis progress", daemon=True)
        ticker.start()
        try:
            yield
        finally:
            self._over.set()
            ticker.join()

    def _tick(self) -> None:
        while not self._over.wait(EVERY_S):
            self.say()

    def begin(self, stage: str) -> None:
        """The next stage."""
        with self._lock:
            self._low, self._high = STAGES[stage]
            self._share, self._left = self._low, None
            self._phase, self._axis, self._cause = stage, None, None
        self.say(always=True)

    def weigh(self, progress: Any) -> None:
        """What identification and diagnosis say of themselves (``invid.numerics.budget.Progress``)."""
        with self._lock:
            self._phase, self._axis, self._cause = str(progress), progress.axis, progress.cause
            within = self._low + float(progress.fraction) * (self._high - self._low)
            self._share = max(self._share, within)
            if progress.seconds_left is not None:
                self._left = self._clock(), float(progress.seconds_left)
        self.say()

    def say(self, *, always: bool = False) -> None:
        """Tell how far it is now; ``always``: a stage has begun, which is told however short it is."""
        with self._lock:
            elapsed = self.elapsed_s
            # a stage that tells nothing moves on by the clock, up to its end
            share = max(self._share, min(elapsed / max(self._expected, 1e-9), self._high))
            eta = self._eta(elapsed)
            phase, axis, cause = self._phase, self._axis, self._cause
        fraction = BEGINS + share * (ENDS - BEGINS)
        self._tell(fraction, phase, axis=axis, cause=cause, eta_s=eta, always=always)

    def _eta(self, elapsed: float) -> float:
        least = OVERDUE * elapsed
        if self._left is None:
            return max(self._expected - elapsed, least)
        said, left = self._left
        after = (1.0 - self._high) * self._expected
        return max(left - (self._clock() - said), 0.0) + after
