"""Estimate how far an analysis is and how long it will take: by what it reports, and by what it took
before.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from invid_drivers.protocol import RunProgress
from invid_service.jobs.countdown import Countdown, Ticker

BEGINS, ENDS = 0.8, 0.99
"""Shares of a whole run between which the analysis lies; motion comes before it."""
STAGES = {
    "reading the recording": (0.0, 0.03),
    "identifying": (0.03, 0.35),
    "diagnosing": (0.35, 0.93),
    "writing the report": (0.93, 1.0),
}
"""Shares of the analysis. Empirical: the case study and cells of one to six axes (``bench_service.py``)."""
PACE_S = 40.0
"""What a first analysis is thought to take, until its own stages say more: the case study on two cores."""
_LEAST_S = {"diagnosing": PACE_S, "writing the report": 0.0}
"""Stages whose beginning says how long a first analysis takes, and the least that is then thought."""

Tell = Callable[..., None]


class AnalysisProgress(Ticker):
    """Reports progress every second, and whenever the analysis says what it weighs, until closed.

    Time left is by what the last analyses took, of a first one by its own stages. What an analysis says of
    its steps is no measure: they are not alike, and most of its budget is never used. Where it takes longer,
    no time is told but the one at which it ends at the latest.

    Parameters
    ----------
    tell
        Called with the progress, and ``always`` where it is never to be left out.
    expected_s
        What the analysis of such runs took before [s]; ``None``: it is the first.
    most_s
        After what time it ends with its best answer so far [s].
    """

    def __init__(
        self,
        tell: Tell,
        expected_s: float | None,
        most_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._tell, self._clock = tell, clock
        self._countdown = Countdown(clock)
        self._expected, self._most = expected_s or PACE_S, most_s
        self._first = expected_s is None
        self._began = clock()
        self._low, self._high = 0.0, 1.0
        self._share = 0.0
        self._phase, self._axis, self._cause = "", None, None
        self._found: list[dict[str, Any]] = []
        self._lock = threading.Lock()

    @property
    def elapsed_s(self) -> float:
        """Return the seconds since the analysis began."""
        return self._clock() - self._began

    def begin(self, stage: str) -> None:
        """Begin the next stage."""
        with self._lock:
            self._low, self._high = STAGES[stage]
            if self._first and stage in _LEAST_S:
                self._expected = max(_LEAST_S[stage], self.elapsed_s / self._low)
            self._share = self._low
            self._phase, self._axis, self._cause = stage, None, None
        self.say(always=True)

    def weigh(self, progress: Any) -> None:
        """Take what identification and diagnosis say of themselves (``invid.numerics.budget.Progress``)."""
        with self._lock:
            self._phase, self._axis, self._cause = str(progress), progress.axis, progress.cause
            self._found = [asdict(f) for f in progress.found]
            within = self._low + float(progress.fraction) * (self._high - self._low)
            self._share = max(self._share, within)
        self.say()

    def say(self, *, always: bool = False) -> None:
        """Report how far it is now; ``always``: a stage has begun, which is told however short it is."""
        with self._lock:
            elapsed = self.elapsed_s
            # a stage that tells nothing moves on by the clock, up to its end
            share = max(self._share, min(elapsed / self._expected, self._high))
            left, most = self._expected - elapsed, max(self._most - elapsed, 0.0)
            told = RunProgress(
                fraction=BEGINS + share * (ENDS - BEGINS),
                phase=self._phase,
                axis=self._axis,
                cause=self._cause,
                found=tuple(self._found),
                eta_s=self._countdown.left(min(left, most) if left > 0.0 else None),
                most_s=most,
            )
        self._tell(told, always=always)
