"""Encoders that stop dead: moving at one sample, and not any more from the next on."""

from __future__ import annotations

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

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
    """The speed before each stand of each encoder, against the accelerations that the axis has shown."""

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
        """Another controller takes over: a drive that begins to hold an axis may stop it at once."""
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
                f"axis {self._names[i]}: the encoder moved at {speed:.3g} {self._unit}/s and from one "
                f"sample to the next not at all, for {self._still[i] * 1e3:.0f} ms now",
                way_out="the encoder is stuck, a brake has closed or the axis has hit something",
                code="halted",
                axis=self._names[i],
            )
