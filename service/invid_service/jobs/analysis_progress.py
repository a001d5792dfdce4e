"""Estimate how far an analysis is and how long it will take: by what it reports, and by what it took
before.
"""

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
PACE_S = 40.0
"""Over which the bar moves in a cell's first run: the case study on two cores. No time is promised by it."""

Tell = Callable[..., None]


class AnalysisProgress:
    """Reports progress every second, and whenever the analysis says what it weighs, until closed.

    Time left is by what the cell's last analyses took. What an analysis says of itself is none: its steps are
    not alike, and most of its budget is never used. Where it is the first, or takes longer, no time is told.

    Parameters
    ----------
    tell
        Called with ``fraction``, ``phase`` and the keywords ``axis``, ``cause``, ``eta_s``, ``always`` (never
        to be left out).
    expected_s
        What the analysis of such runs took before [s]; ``None``: it is the first.
    """

    def __init__(
        self, tell: Tell, expected_s: float | None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell, self._clock = tell, clock
        self._expected = expected_s
        self._began = clock()
        self._low, self._high = 0.0, 1.0
        self._share = 0.0
        self._phase, self._axis, self._cause = "", None, None
        self._lock = threading.Lock()
        self._over = threading.Event()

    @property
    def elapsed_s(self) -> float:
        """Return the seconds since the analysis began."""
        return self._clock() - self._began

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """Context manager in which a thread reports progress every second."""
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
        """Begin the next stage."""
        with self._lock:
            self._low, self._high = STAGES[stage]
            self._share = self._low
            self._phase, self._axis, self._cause = stage, None, None
        self.say(always=True)

    def weigh(self, progress: Any) -> None:
        """Take what identification and diagnosis say of themselves (``invid.numerics.budget.Progress``)."""
        with self._lock:
            found = f" (found so far: {', '.join(progress.found)}; still looking)" if progress.found else ""
            self._phase, self._axis, self._cause = f"{progress}{found}", progress.axis, progress.cause
            within = self._low + float(progress.fraction) * (self._high - self._low)
            self._share = max(self._share, within)
        self.say()

    def say(self, *, always: bool = False) -> None:
        """Report how far it is now; ``always``: a stage has begun, which is told however short it is."""
        with self._lock:
            elapsed = self.elapsed_s
            # a stage that tells nothing moves on by the clock, up to its end
            share = max(self._share, min(elapsed / (self._expected or PACE_S), self._high))
            left = None if self._expected is None else self._expected - elapsed
            eta = None if left is None or left <= 0.0 else left
            phase, axis, cause = self._phase, self._axis, self._cause
        fraction = BEGINS + share * (ENDS - BEGINS)
        self._tell(fraction, phase, axis=axis, cause=cause, eta_s=eta, always=always)
