"""Whether an axis that is to stand falls or is driven away, by its position and what its torque does.

Over one window of n samples in quarters of length h, with mean positions m₁…m₄, the acceleration is

    a = (m₁ − m₂ − m₃ + m₄) / 2h²,    σ_a = q/√12 · √(16/n) / 2h²

where q is one count of the encoder: rounding is all the noise that an axis at rest has. The window is the
shortest in which ``SEEN`` is ``SIGMAS`` deviations: for white rounding one alarm in 10⁹ looks, and each
alarm also needs a way of ``AWAY`` and a torque that does not hold. What is held speeds up for a moment too
(a brake opens, a loop sags): then its torque grows against the motion and the acceleration shrinks on the
way, which 2·a·x/v² tells whenever the motion began: 1 under a constant force, less under a spring, up to 2
where the acceleration grows with the way. So an axis

- *falls* where it speeds up away from its place, and the torque against that does not grow or is all of it;
- *is driven* where its torque pushes it away, or its acceleration grows with the torque that seems to brake.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from enum import Enum

from invid.sweep.ports import Sample

SIGMAS = 6.0
SEEN = 1.0
"""Acceleration [rad/s² or m/s²] that is told from rest: a tenth of what gravity does to a free mass."""
WINDOWS_S = (0.04, 0.08, 0.16, 0.32)
LEAST_SAMPLES = 16
AWAY = 0.004
"""Of the window: within it no axis is called falling. Stiff loops sag less; of a soft one the torque has
grown by then (empirical: loops of 2 Hz and more under up to half of rated torque)."""
COUNTS = 4
"""Counts that are no way: both ends with their last digits."""
GROWS = 0.015
"""Of rated torque: four deviations between two means of five samples with 0.5 % noise each."""
STEEPER, SHALLOWER = 1.3, 0.75
"""2·a·x/v² from quarter means: 1.0 to 1.12 under a constant force, wherever in the window it sets in."""
PLACE_S = 0.3
"""Time constant of the place from which an axis moves away."""
BEYOND = 1.2
"""Over the farthest turn so far: what others shake goes to and fro."""
FULL = 0.9
"""Share of the torque limit that is all of it, with the noise of 0x6077."""


class Kind(Enum):
    """What moves an axis that is to stand."""

    FALLS = "what holds it gives too little"
    DRIVEN = "its own drive drives it away"


@dataclass(frozen=True)
class Fall:
    """One axis that does not stand: why, how it speeds up [rad/s² or m/s²], and by what torque [N·m or N]."""

    kind: Kind
    acceleration: float
    torque: float
    at_limit: bool


def window_of(resolution: float, cycle_s: float) -> tuple[int, float]:
    """Samples of the shortest window in which ``SEEN`` is told from rest, and the deviation of its
    acceleration."""
    for seconds in WINDOWS_S:
        count = 4 * math.ceil(max(seconds / cycle_s, LEAST_SAMPLES) / 4)
        h = count * cycle_s / 4
        sigma = abs(resolution) / math.sqrt(12.0) * math.sqrt(16.0 / count) / (2 * h * h)
        if SIGMAS * sigma <= SEEN:
            break
    return count, sigma


class _Axis:
    def __init__(self, resolution: float, cycle_s: float, window: float, rated: float, limit: float) -> None:
        self.count, self.sigma = window_of(resolution, cycle_s)
        self.h = self.count * cycle_s / 4
        self.least = COUNTS * abs(resolution)
        self.away = max(AWAY * window, self.least)
        self.grows = GROWS * rated
        self.limit = FULL * limit
        self.stride = max(1, self.count // 8)
        self.keep = math.exp(-cycle_s / PLACE_S)
        self.forget()

    def forget(self) -> None:
        self.x: deque[float] = deque(maxlen=self.count)
        self.torque: deque[float] = deque(maxlen=self.count)
        self.time: float | None = None
        self.place: float | None = None
        self.rest: float | None = None
        self.reach = 0.0
        self.due = 0
        self.rising = 0.0

    def take(self, time: float, x: float, torque: float, *, quiet: bool = True) -> Fall | None:
        if self.time is not None and time - self.time > 1.6 * self.h / (self.count / 4):
            self.x.clear()  # a gap: quarters are no longer of one length
            self.torque.clear()
        self.time = time
        self.place = x if self.place is None else x + self.keep * (self.place - x)
        self.x.append(x)
        self.torque.append(torque)
        self.due += 1
        if len(self.x) < self.count or self.due < self.stride:
            return None
        self.due = 0
        if max(abs(x - self.x[0]), abs(x - self.x[self.count // 2])) <= self.least:
            self.rest = x
            return None
        return self.judge(quiet)

    def judge(self, quiet: bool) -> Fall | None:
        n = self.count // 4
        x, torque = list(self.x), list(self.torque)
        m1, m2, m3, m4 = (sum(x[k * n : (k + 1) * n]) / n for k in range(4))
        last = m4 - m3
        d = 1.0 if last > 0 else -1.0
        place = self.place if self.place is not None else m1
        if last * self.rising < 0:
            self.reach = max(0.9 * self.reach, abs(m3 - place))  # it has turned
        self.rising = last
        acceleration = d * (m1 - m2 - m3 + m4) / (2 * self.h * self.h)
        away = d * (m4 - place)
        if acceleration < max(SIGMAS * self.sigma, SEEN / 4) or away < max(self.least, BEYOND * self.reach):
            return None
        early = -d * sum(torque[:n]) / n
        late = -d * sum(torque[3 * n :]) / n
        grown = late - early
        full = abs(late) >= self.limit
        pushes = late < -2 * self.grows and grown < 0 and away > self.away
        curve = self._curve(x, n, d)
        steep = max(curve, self._curve(x, max(2, n // 2), d)) > STEEPER
        if pushes or (grown > self.grows and steep and (quiet or full)):
            return Fall(Kind.DRIVEN, acceleration, -d * late, full)
        if away > self.away and (grown <= self.grows or full) and (curve == 0.0 or curve > SHALLOWER):
            return Fall(Kind.FALLS, acceleration, -d * late, full)
        return None

    def _curve(self, x: Sequence[float], n: int, d: float) -> float:
        """2·a·x/v² over the last three means of n samples; 0 where nobody knows where it rested, or counts
        blur it."""
        m2, m3, m4 = (sum(x[len(x) - k * n : len(x) - (k - 1) * n]) / n for k in (3, 2, 1))
        bend = d * (m2 - 2 * m3 + m4)
        if self.rest is None or bend < self.least:
            return 0.0
        return 2 * bend * d * ((m3 + m4) / 2 - self.rest) / (m4 - m3) ** 2


class Falling:
    """Watch over axes that are to stand, sample by sample."""

    def __init__(
        self,
        resolution: Sequence[float],
        cycle_s: float,
        window: Sequence[float],
        rated: Sequence[float],
        limit: Sequence[float],
    ) -> None:
        """``resolution``: one count [rad or m]; ``window``: half of the way; ``rated`` and ``limit``:
        torque."""
        self._axes = [
            _Axis(q, cycle_s, w, r, t) for q, w, r, t in zip(resolution, window, rated, limit, strict=True)
        ]

    def forget(self) -> None:
        """What comes next follows from nothing before."""
        for axis in self._axes:
            axis.forget()

    def check(
        self,
        sample: Sample,
        axes: Collection[int],
        judged: Callable[[int], bool] = lambda status: True,
        *,
        quiet: bool = False,
    ) -> dict[int, Fall]:
        """Which of ``axes`` do not stand; of the others everything is forgotten.

        ``judged``: whether an axis is to stand in the state of its statusword; its way is remembered all
        the same.
        """
        found = {}
        for i, axis in enumerate(self._axes):
            if i not in axes:
                if axis.time is not None:
                    axis.forget()
            elif sample.fresh[i]:
                fall = axis.take(sample.time, sample.position[i], sample.torque[i], quiet=quiet)
                if fall is not None and judged(sample.status[i]):
                    found[i] = fall
        return found
