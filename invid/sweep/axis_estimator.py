"""Place, speed and standing of one axis, and whether what is to stand falls or is driven away.

Over one window of n samples in quarters of length h, with mean positions m₁…m₄, the acceleration is

    a = (m₁ − m₂ − m₃ + m₄) / 2h²,    σ_a = σ · √(16/n) / 2h²

where σ is the noise of one sample: what the axis showed at rest without power, and a count's rounding q/√12
at least. The window is the shortest in which ``SEEN`` is ``SIGMAS`` deviations: for white noise one alarm in
10⁹ looks, and each alarm also needs a way of ``AWAY`` and a torque that does not hold. What is held speeds up
for a moment too (a brake opens, a loop sags): then its torque grows against the motion and the acceleration
shrinks on the way, which 2·a·x/v² tells whenever the motion began: 1 under a constant force, less under a
spring, up to 2 where the acceleration grows with the way. So an axis

- *falls* where it speeds up away from its place, and the torque against that does not grow or is all of it:
  within ``AWAY`` only where it ceases meanwhile, which no loop does but one that begins anew;
- *is driven* where its torque pushes it away, or its acceleration grows with the torque that seems to brake.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

SIGMAS = 6.0
SEEN = 1.0
"""Acceleration [rad/s² or m/s²] that is told from rest: a tenth of what gravity does to a free mass."""
WINDOWS_S = (0.04, 0.08, 0.16, 0.32)
LEAST_SAMPLES = 16
AWAY = 0.004
"""Of the window: within it no axis is called falling. Stiff loops sag less; of a soft one the torque has
grown by then (empirical: loops of 2 Hz and more under up to half of rated torque)."""
COUNTS, DEVIATIONS = 4, 6
"""Counts, and deviations of the noise, that are no way: both ends with their last digits."""
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
STAND_S = 0.3
"""An axis stands that has stayed within its tolerance for so long: one that falls with 0.02 rad/s² leaves
that of a window of 0.5 rad by then."""
STILL_COUNTS, STILL_SHARE, STILL_DEVIATIONS = 8, 0.002, 8
"""What is no motion of a standing axis: counts, a share of its window, deviations of the noise (of the
difference of two samples the largest of 150 is five)."""
LEAP, LEAP_COUNTS, LEAP_DEVIATIONS = 4.0, 8, 12
"""Times the speed that it has lately had (``PLACE_S``) from one sample to the next, or the permitted speed
for so many cycles, so many counts and deviations: a mass does not get there meanwhile, an encoder has leapt.
Drives that bring 0x6064 up to date every few cycles show leaps of that many (empirical)."""
SPEED_SAMPLES = 8
"""Samples of a speed: means of both halves."""
MOST_MISSING = 8
"""Samples in a row that are filled; beyond that nobody knows what happened meanwhile."""
LEARN_SAMPLES = 30
"""Samples at rest from which noise is learnt: a deviation to 15 %."""


@dataclass(frozen=True)
class AxisLimits:
    """Limits of one axis in SI units, and its encoder count."""

    name: str
    torque: float
    position: float
    velocity: float
    resolution: float
    rated_torque: float
    unit: str
    torque_unit: str


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


def window_of(noise: float, cycle_s: float) -> tuple[int, float]:
    """Samples of the shortest window in which ``SEEN`` is told from rest, and the deviation of its
    acceleration."""
    for seconds in WINDOWS_S:
        count = 4 * math.ceil(max(seconds / cycle_s, LEAST_SAMPLES) / 4)
        h = count * cycle_s / 4
        sigma = noise * math.sqrt(16.0 / count) / (2 * h * h)
        if SIGMAS * sigma <= SEEN:
            break
    return count, sigma


class AxisEstimator:
    """One axis, sample by sample."""

    def __init__(self, limits: AxisLimits, cycle_s: float) -> None:
        self.limits, self._cycle = limits, cycle_s
        self._at_rest: list[float] = []
        self._grows = GROWS * limits.rated_torque
        self._limit = FULL * limits.torque
        self._keep = math.exp(-cycle_s / PLACE_S)
        self.time: float | None = None
        self.position = 0.0
        self.speed = 0.0
        """Mean over the last samples [rad/s or m/s]."""
        self._lately = 0.0
        self.leapt = 0.0
        """How far its encoder went between two samples where that is further than the axis can."""
        self.fall: Fall | None = None
        """What the last sample told."""
        self.is_to_stand = True
        self._set_noise(0.0)
        self.begin()

    def _set_noise(self, noise: float) -> None:
        resolution = abs(self.limits.resolution)
        self.noise = max(noise, resolution / math.sqrt(12.0))
        """Deviation of one sample at rest [rad or m]."""
        self.count, self.sigma = window_of(self.noise, self._cycle)
        self._h = self.count * self._cycle / 4
        self._least = max(COUNTS * resolution, DEVIATIONS * self.noise)
        self._away = max(AWAY * self.limits.position, self._least)
        self._stride = max(1, self.count // 8)
        self.tolerance = max(
            STILL_COUNTS * resolution, STILL_SHARE * self.limits.position, STILL_DEVIATIONS * self.noise
        )
        """How far it may go and still stand [rad or m]."""

    # --- at rest without power -----------------------------------------------------------------
    def learn_noise(self, position: float) -> None:
        """Take a position of the axis at rest without power."""
        self._at_rest.append(position)

    def use_noise(self) -> None:
        """Take over the noise of what was learnt: from second differences, so no slow motion counts."""
        if len(self._at_rest) >= LEARN_SAMPLES:
            self._set_noise(float(np.std(np.diff(self._at_rest, 2))) / math.sqrt(6.0))
            self.begin()
        self._at_rest = []

    # --- while it is watched -------------------------------------------------------------------
    def begin(self) -> None:
        """What comes next follows from nothing before."""
        self._x: deque[float] = deque(maxlen=self.count)
        self._track: deque[tuple[float, float]] = deque(maxlen=SPEED_SAMPLES)
        self._torque: deque[float] = deque(maxlen=self.count)
        self.time = None
        self._place: float | None = None
        self._rest: float | None = None
        self._reach = self._rising = 0.0
        self._due = 0
        self.fall = None
        self._shown: deque[float] = deque(maxlen=max(1, round(STAND_S / 2 / self._cycle)))
        self.look_anew()

    def look_anew(self) -> None:
        """Whether it stands is seen from here on: what held it until now holds it no longer."""
        self._since: tuple[float, float] | None = None
        self._anew: float | None = None
        self.stands = False

    def expect_standing(self, expected: bool) -> None:
        """Judge from here on whether it stands, or do not."""
        if expected and not self.is_to_stand:
            self.begin()
        self.is_to_stand = expected

    def take(self, time: float, position: float, torque: float, *, quiet: bool = False) -> None:
        """One sample; ``quiet``: nothing is shaken, so what grows with its torque is no excitation."""
        self.fall = None
        if self.time is not None:
            if time <= self.time:
                return
            self._see_leap(abs(position - self.position), time - self.time)
            self._fill(round((time - self.time) / self._cycle) - 1, position, torque)
        self.time, self.position = time, position
        keep = self._keep
        self._place = position if self._place is None else position + keep * (self._place - position)
        self._shown.append(torque)
        self._x.append(position)
        self._torque.append(torque)
        self._see_standing(time, position)
        self._due += 1
        self._track.append((time, position))
        if len(self._track) == SPEED_SAMPLES:
            self.speed = self._slope()
        self._lately = max(abs(self.speed), keep * self._lately)
        if not self.is_to_stand or len(self._x) < self.count or self._due < self._stride:
            return
        self._due = 0
        if max(abs(position - self._x[0]), abs(position - self._x[self.count // 2])) <= self._least:
            self._rest = position
            return
        self.fall = self._judge(quiet)

    def _see_leap(self, way: float, seconds: float) -> None:
        """Whether its encoder went further between two samples than the axis can."""
        least = max(LEAP_COUNTS * abs(self.limits.resolution), LEAP_DEVIATIONS * self.noise)
        at_most = max(LEAP * self._lately * seconds, self.limits.velocity * max(LEAP * self._cycle, seconds))
        if way > max(at_most, least):
            self.leapt = way

    def _fill(self, missing: int, position: float, torque: float) -> None:
        """Quarters stay of one length: what did not come lies between what did. While the master is silent a
        drive that is asked answers every few cycles."""
        if missing > MOST_MISSING:
            self._x.clear()
            self._torque.clear()
        elif missing > 0 and self._x:
            x, t = self._x[-1], self._torque[-1]
            for k in range(1, missing + 1):
                share = k / (missing + 1)
                self._x.append(x + share * (position - x))
                self._torque.append(t + share * (torque - t))

    @property
    def torque(self) -> float:
        """Mean torque over half of the time after which an axis stands [N·m or N]."""
        return sum(self._shown) / max(1, len(self._shown))

    def _slope(self) -> float:
        track, half = list(self._track), SPEED_SAMPLES // 2
        seconds = sum(t for t, _ in track[half:]) - sum(t for t, _ in track[:half])
        return (sum(x for _, x in track[half:]) - sum(x for _, x in track[:half])) / seconds

    def _see_standing(self, time: float, position: float) -> None:
        since = self._since
        self._anew = time if self._anew is None else self._anew
        if since is None or abs(position - since[1]) > self.tolerance:
            self._since, self.stands = (time, position), False
        else:
            self.stands = time - since[0] >= STAND_S

    def _judge(self, quiet: bool) -> Fall | None:
        n = self.count // 4
        x, torque = list(self._x), list(self._torque)
        m1, m2, m3, m4 = (sum(x[k * n : (k + 1) * n]) / n for k in range(4))
        last = m4 - m3
        d = 1.0 if last > 0 else -1.0
        place = self._place if self._place is not None else m1
        if last * self._rising < 0:
            self._reach = max(0.9 * self._reach, abs(m3 - place))  # it has turned
        self._rising = last
        acceleration = d * (m1 - m2 - m3 + m4) / (2 * self._h * self._h)
        away = d * (m4 - place)
        least = max(self._least, BEYOND * self._reach)
        if acceleration < max(SIGMAS * self.sigma, SEEN / 4) or away < least:
            return None
        early = -d * sum(torque[:n]) / n
        late = -d * sum(torque[3 * n :]) / n
        grown = late - early
        full = abs(late) >= self._limit
        pushes = late < -2 * self._grows and grown < 0 and away > self._away
        curve = self._curve(x, n, d)
        steep = max(curve, self._curve(x, max(2, n // 2), d)) > STEEPER
        if pushes or (grown > self._grows and steep and (quiet or full)):
            return Fall(Kind.DRIVEN, acceleration, -d * late, full)
        settled = self._anew is not None and (self.time or 0.0) - self._anew >= STAND_S
        ceases = settled and grown < -self._grows and early > self._grows
        holds_not = ceases or (away > self._away and (grown <= self._grows or full))
        if holds_not and (curve == 0.0 or curve > SHALLOWER):
            return Fall(Kind.FALLS, acceleration, -d * late, full)
        return None

    def _curve(self, x: Sequence[float], n: int, d: float) -> float:
        """2·a·x/v² over the last three means of n samples; 0 where nobody knows where it rested, counts blur
        it, or it does not go on."""
        m2, m3, m4 = (sum(x[len(x) - k * n : len(x) - (k - 1) * n]) / n for k in (3, 2, 1))
        bend = d * (m2 - 2 * m3 + m4)
        if self._rest is None or bend < self._least or d * (m4 - m3) <= 0.0:
            return 0.0
        return 2 * bend * d * ((m3 + m4) / 2 - self._rest) / (m4 - m3) ** 2
