"""Estimate how far a run is and how long it takes: told every second, and whenever the run says something."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from invid_service.jobs.protocol import FoundCause, Known, RunnerLine, RunProgress

EVERY_S = 1.0
PROGRESS_PERIOD_S, MOST_WAITING = 0.2, 200
"""Progress is told so often at most, and not while so many messages wait for whoever reads them."""
SLOWER = 0.5
"""Pace at which time left is counted while more is expected than was told (a convention)."""
BEGINS, ENDS = 0.8, 0.99
"""Shares of a whole run between which the analysis lies; motion comes before it."""
STAGES = {
    "reading the recording": (0.0, 0.03),
    "identifying": (0.03, 0.35),
    "diagnosing": (0.35, 0.93),
    "writing the report": (0.93, 1.0),
}
"""Shares of the analysis. Empirical: the case study and cells of one to six axes."""
PACE_S = 40.0
"""What a first analysis is thought to take, until its own stages say more: the case study on two cores."""
_LEAST_S = {"diagnosing": PACE_S, "writing the report": 0.0}
"""Stages whose beginning says how long a first analysis takes, and the least that is then thought."""
_SETTLED_S = 2.0
"""Robot time after which the pace of the motion so far says how long the rest takes."""


class _Told:
    """Tells ``now()`` every second until closed. Time left as it is told never rises, and where it has run
    out nothing is promised.
    """

    def __init__(self, line: RunnerLine) -> None:
        self._line, self._said = line, 0.0
        self._began = time.monotonic()
        self._left: tuple[float, float] | None = None
        """When time left was told last, and what."""
        self._over = threading.Event()
        self._lock = threading.Lock()

    @property
    def elapsed_s(self) -> float:
        """Return the seconds since it began."""
        return time.monotonic() - self._began

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
        """Report how far it is now, no more often than it is read; ``always``: at any rate."""
        with self._lock:
            now = time.monotonic()
            often = now - self._said < PROGRESS_PERIOD_S or self._line.waiting > MOST_WAITING
            told = None if often and not always else self.now()
            if told is not None:
                self._said = now
                self._line.tell(told)

    def now(self) -> RunProgress | None:
        """Return how far it is; ``None`` where nothing is known yet."""
        raise NotImplementedError

    def count_down(self, estimate: float | None) -> float | None:
        """Return the seconds left as they are told now, by an estimate that may change."""
        now = time.monotonic()
        then, before = self._left or (now, math.inf if estimate is None else max(estimate, 0.0))
        told = max(before - (now - then) if estimate is None else estimate, 0.0)
        if told > before - (now - then):  # never up: slower
            told = max(min(before - SLOWER * (now - then), told), 0.0)
        if math.isinf(told):
            return None
        self._left = now, told
        return told if told > 0.0 else None


class MotionProgress(_Told):
    """Of a motion, also while it stands between two runs.

    Time left is what the plan has left at the pace of the clock so far: a simulated cell runs ahead of it, a
    busy one behind, and looks between runs take their time. How far it is changes with the motion alone: by
    that the service sees that it does not hang. ``after_s``: what the analysis is thought to take then.
    """

    def __init__(self, line: RunnerLine, after_s: float | None) -> None:
        super().__init__(line)
        self._after = after_s
        self._first: tuple[float, float] | None = None
        self._heard = 0.0
        self._last: Any = None
        self.known: Known | None = None
        """What the runs so far tell."""

    def moved(self, progress: Any) -> None:
        """Take what the motion says of itself (``invid.sweep.Progress``)."""
        with self._lock:
            self._heard, self._last = self.elapsed_s, progress
            self._first = self._first or (self._heard, float(progress.eta_s))
        self.say()

    def now(self) -> RunProgress | None:
        """Return how far the motion is."""
        if self._first is None:
            return None
        p, (began, whole) = self._last, self._first
        done = whole - float(p.eta_s)
        pace = (self._heard - began) / done if done > _SETTLED_S else 1.0
        left = self.count_down(pace * float(p.eta_s) - (self.elapsed_s - self._heard))
        return RunProgress(
            progress=float(p.fraction) * BEGINS,
            phase=p.phase,
            axis=p.axis,
            frequency=p.frequency,
            eta_s=None if self._after is None or left is None else left + self._after,
            motion_left_s=left,
            known=self.known,
        )


class AnalysisProgress(_Told):
    """Of an analysis.

    Time left is by what the last analyses took (``expected_s``), of a first one by its own stages: what an
    analysis says of its steps is no measure, since most of its budget is never used. Where it takes longer,
    no time is told but the one at which it ends at the latest (``most_s``).
    """

    def __init__(self, line: RunnerLine, expected_s: float | None, most_s: float) -> None:
        super().__init__(line)
        self._expected, self._most = expected_s or PACE_S, most_s
        self._first = expected_s is None
        self._low, self._high, self._share = 0.0, 1.0, 0.0
        self._what = RunProgress()

    def begin(self, stage: str) -> None:
        """Begin the next stage."""
        with self._lock:
            self._low, self._high = STAGES[stage]
            if self._first and stage in _LEAST_S:
                self._expected = max(_LEAST_S[stage], self.elapsed_s / self._low)
            self._share = self._low
            self._what = RunProgress(phase=stage, found=self._what.found)
        self.say(always=True)  # however short the stage is

    def weigh(self, progress: Any) -> None:
        """Take what identification and diagnosis say of themselves (``invid.numerics.budget.Progress``)."""
        with self._lock:
            found = [FoundCause(**asdict(f)) for f in progress.found]
            self._what = RunProgress(
                phase=str(progress), axis=progress.axis, cause=progress.cause, found=found
            )
            self._share = max(self._share, self._low + float(progress.fraction) * (self._high - self._low))
        self.say()

    def now(self) -> RunProgress:
        """Return how far the analysis is."""
        elapsed = self.elapsed_s
        # a stage that tells nothing moves on by the clock, up to its end
        share = max(self._share, min(elapsed / self._expected, self._high))
        left, most = self._expected - elapsed, max(self._most - elapsed, 0.0)
        told: dict[str, float | None] = {"progress": BEGINS + share * (ENDS - BEGINS), "most_s": most}
        told["eta_s"] = self.count_down(min(left, most) if left > 0.0 else None)
        return self._what.model_copy(update=told)
