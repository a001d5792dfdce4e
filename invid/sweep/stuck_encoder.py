"""Watch for encoders that stand although they should not, that stop dead, and for axes that yield to a
push.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence

from invid.errors import SafetyStop
from invid.sweep.axis_estimator import AxisEstimator
from invid.sweep.ports import Sample
from invid.wording.sentence import sentence

HALT_CYCLES, HALT_S = 5, 0.01
"""So long one value must stand. A drive that brings a new position only every few cycles stands and leaps all
the time: its leaps count as accelerations seen, and it is never suspected."""
HALT_FACTOR = 3.0
"""The stop must have taken three times the acceleration of anything seen before it. A mass that friction
brings to rest from more than three samples' worth of its deceleration was seen to decelerate: so it is never
a stop of this kind. An encoder that dies, a brake that falls in and a hard stop are."""
HALT_COUNTS = 8
"""And come from at least eight counts a cycle: the steps of an encoder alone make a difference of differences
of two, and three times that is six."""


class Halting:
    """Watch over the speed before each stand of each encoder, against the accelerations that the axis
    has shown.
    """

    def __init__(self, names: list[str], resolution: list[float], unit: str, cycle_s: float) -> None:
        self._names, self._unit, self._cycle = names, unit, cycle_s
        self._least = [HALT_COUNTS * r for r in resolution]
        self._long = max(HALT_CYCLES * cycle_s, HALT_S)
        count = len(names)
        self._seen: list[tuple[int, float, float] | None] = [None] * count
        self._speed: list[float | None] = [None] * count
        self._before: list[float | None] = [None] * count
        self._greatest = [0.0] * count
        self._still = [0.0] * count

    def pause(self) -> None:
        """Note that another controller takes over: a drive that begins to hold an axis may stop it at
        once.
        """
        self._seen = [None] * len(self._seen)

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop where an encoder has stopped as no mass stops."""
        for i, fresh in enumerate(sample.fresh):
            if not fresh:
                continue
            last, position = self._seen[i], sample.position[i]
            self._seen[i] = (sample.slot, sample.time, position)
            if last is None or sample.slot != last[0] + 1 or sample.time <= last[1]:
                # nobody knows what happened in between
                self._speed[i] = self._before[i] = None
                self._still[i] = 0.0
                continue
            dt = sample.time - last[1]
            if position != last[2]:
                self._moved(i, (position - last[2]) / dt)
            else:
                self._stands(i, dt)

    def _moved(self, i: int, speed: float) -> None:
        before = 0.0 if self._still[i] > 0.0 else self._speed[i]
        if self._still[i] > 0.0 and self._before[i] is not None:
            # it stood and goes on: stops like that one are its nature
            self._greatest[i] = max(self._greatest[i], abs(self._before[i] or 0.0) / self._cycle)
        if before is not None:
            self._greatest[i] = max(self._greatest[i], abs(speed - before) / self._cycle)
            slower = min(abs(speed), abs(before)) if speed * before > 0.0 else 0.0
            self._before[i] = slower
        self._speed[i], self._still[i] = speed, 0.0

    def _stands(self, i: int, dt: float) -> None:
        self._still[i] += dt
        speed = self._before[i]
        if (
            speed is not None
            and self._still[i] >= self._long
            and speed * self._cycle >= self._least[i]
            and speed / self._cycle > HALT_FACTOR * self._greatest[i]
        ):
            raise SafetyStop(
                sentence(
                    "axis {axis}: the encoder moved at {speed:.3g} {unit}/s and from one sample to the "
                    "next not at all, for {still:.0f} ms now",
                    axis=self._names[i],
                    speed=speed,
                    unit=self._unit,
                    still=self._still[i] * 1e3,
                ),
                way_out="the encoder is stuck, a brake has closed or the axis has hit something",
                code="halted",
                axis=self._names[i],
            )


LAGS = (1, 4, 12)
"""Cycles by which torque may act later than it is asked for: whichever says least is believed."""
UNMOVED_COUNTS = 1.5
"""Counts from its place within which an encoder shows no motion: a last digit that flickers."""
TURNING = 2 * 4 * 2 * UNMOVED_COUNTS
"""Counts: where the motion of a free mass turns, it stays within a way q for at most 2·√(2q/a), in which its
torque would have taken it 4·q from rest, whatever a is: the way to and fro between both ends of
``UNMOVED_COUNTS``, and as much again for torque that changes meanwhile. What stands longer is held."""
UNMOVED, UNMOVED_SHARE = 2 * TURNING, 0.01
"""Counts by which a mass that something held as before would have moved: twice as many again for inertia and
weight, which were measured. And no less than that share of the window: springs that are wound up hold a fine
encoder's place for a moment, and so short a way does no harm."""
HELD_MORE = 1.5
"""Over what held it so far: friction differs from place to place."""


class _Mass:
    """A rigid mass under torque, from rest, held by friction down and up to ``holds``."""

    x = v = 0.0

    def go(self, torque: float, holds: tuple[float, float], inertia: float, dt: float) -> None:
        down, up = holds
        if self.v == 0.0 and -down <= torque <= up:
            return
        moving = self.v if self.v != 0.0 else torque
        force = torque - up if moving > 0.0 else torque + down
        after = self.v + force / inertia * dt
        self.v = 0.0 if after * moving < 0.0 else after
        self.x += self.v * dt


class _Stand:
    """What masses would have done since an encoder came to its place."""

    def __init__(self, place: float) -> None:
        self.place, self.peaks = place, (0.0, 0.0)
        self._free, self._held = [_Mass() for _ in LAGS], [_Mass() for _ in LAGS]

    def go(self, torques: Sequence[float], holds: tuple[float, float], inertia: float, dt: float) -> None:
        down, up = self.peaks
        self.peaks = max(down, -torques[0]), max(up, torques[0])
        for free, held, torque in zip(self._free, self._held, torques, strict=True):
            free.go(torque, (0.0, 0.0), inertia, dt)
            held.go(torque, holds, inertia, dt)

    @property
    def free(self) -> float:
        return min(abs(mass.x) for mass in self._free)

    @property
    def held(self) -> float:
        return min(abs(mass.x) for mass in self._held)


class Unmoved:
    """Watch for encoders that stand while the torque that is asked for must have moved their axes.

    Two masses are reckoned from the begin of each stand: a free one, and one that friction holds as far as
    it held the axis before. A stand in which the free mass would have gone further than at any turn
    (``TURNING``) is friction's, and tells when it ends how much that holds at least. Where the second mass
    would have moved, too, the encoder is dead, or something new holds the axis: no chance is in that but
    friction that was never met, by half more than before. A load on a worm gear is held more against it than
    with it, so either direction is judged by itself, from when the axis was seen to move in it.
    """

    def __init__(
        self, names: Sequence[str], resolution: Sequence[float], window: Sequence[float], cycle_s: float
    ) -> None:
        """``resolution`` of the encoders and ``window`` of the axes [rad or m]."""
        self._names, self._cycle = list(names), cycle_s
        self._flicker = [UNMOVED_COUNTS * abs(r) for r in resolution]
        self._most_way = [
            max(UNMOVED * abs(r), UNMOVED_SHARE * w) for r, w in zip(resolution, window, strict=True)
        ]
        self._masses: Mapping[int, tuple[float, float]] = {}
        self._most: dict[int, tuple[float, float]] = {}
        self._seen = [(0.0, 0.0)] * len(self._names)
        self.forget()

    def begin(self, masses: Mapping[int, tuple[float, float]]) -> None:
        """Reckon from now on with the inertia and weight of each axis whose loop the master closes."""
        self._masses = masses
        self.forget()

    def forget(self) -> None:
        """Nobody knows what happened meanwhile; what friction holds stays known."""
        self._stands: list[_Stand | None] = [None] * len(self._names)
        self._asked: list[deque[float]] = [deque(maxlen=max(LAGS) + 1) for _ in self._names]

    def moved_by(self, axis: int, torque: float, ways: tuple[bool, bool] = (True, True)) -> None:
        """Judge an axis from here on: friction holds no more than so much torque, which moved it down or
        up."""
        down, up = ways
        self._most[axis] = torque if down else math.inf, torque if up else math.inf

    def check(self, sample: Sample, asked: Sequence[float]) -> None:
        """SafetyStop where an encoder has not moved with its axis."""
        for i, (inertia, weight) in self._masses.items():
            past, stand, x = self._asked[i], self._stands[i], sample.position[i]
            past.append(asked[i] - weight)
            if not sample.fresh[i] or len(past) <= max(LAGS):
                continue
            if stand is None or abs(x - stand.place) > self._flicker[i]:
                if stand is not None and stand.free > self._most_way[i] * TURNING / UNMOVED:
                    down, up = map(max, self._seen[i], stand.peaks)
                    self._seen[i] = down, up
                self._stands[i] = _Stand(x)
                continue
            most = self._most.get(i, (math.inf, math.inf))
            down, up = (HELD_MORE * max(m, seen) for m, seen in zip(most, self._seen[i], strict=True))
            stand.go([past[-1 - lag] for lag in LAGS], (down, up), inertia, self._cycle)
            if stand.held > self._most_way[i]:
                counts = UNMOVED_COUNTS * stand.held / self._flicker[i]
                raise SafetyStop(
                    f"axis {self._names[i]}: the encoder shows one value while the torque that is played "
                    f"must have moved the axis by {counts:.0f} counts",
                    way_out="the encoder is stuck, the brake is closed, or the drive gives no torque",
                    code="stands",
                    axis=self._names[i],
                )


AT_LIMIT = 0.95
"""Share of the torque limit that counts as all of it, with the noise of 0x6077."""
YIELD_S = 0.02
"""It must last so long. In a healthy run no feedback reaches the limit at all."""
FASTER, SPEED_SHARE = 1.2, 0.05
"""Speed over that at which the limit was reached, beyond this share of the speed limit: what brakes with all
its torque slows down. A spring may pull as hard for a moment, but it does not hold out (empirical)."""


class Yielding:
    """Watch over the speed of each axis since its torque came to the limit against its motion."""

    def __init__(self, estimators: Sequence[AxisEstimator]) -> None:
        self._estimators = estimators
        self._since: list[tuple[float, float] | None] = [None] * len(estimators)

    def check(self, sample: Sample, led: Collection[int]) -> None:
        """Raise SafetyStop where an axis yields whose loop the master closes (``led``)."""
        for i, estimator in enumerate(self._estimators):
            if not sample.fresh[i]:
                continue
            limits, speed, torque = estimator.limits, estimator.speed, sample.torque[i]
            if abs(torque) < AT_LIMIT * limits.torque or torque * speed >= 0.0 or i not in led:
                self._since[i] = None
                continue
            since = self._since[i]
            if since is None:
                self._since[i] = sample.time, abs(speed)
                continue
            fast = FASTER * since[1] + SPEED_SHARE * limits.velocity
            if sample.time - since[0] >= YIELD_S and abs(speed) > fast:
                raise SafetyStop(
                    sentence(
                        "axis {axis}: gets faster against the torque limit: {speed:.3g} {unit}/s, "
                        "{before:.3g} {ms:.0f} ms before",
                        axis=limits.name,
                        speed=abs(speed),
                        unit=limits.unit,
                        before=since[1],
                        ms=1e3 * (sample.time - since[0]),
                    ),
                    way_out="somebody pushes it, a sign is wrong in the drive, or its load is beyond the "
                    "limit: compare 0x6076 with the motor's plate, or raise the limit",
                    code="yields",
                    axis=limits.name,
                )
