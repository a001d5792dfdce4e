"""Encoders that stand still although they should not: stuck, or behind a brake that has closed."""

from __future__ import annotations

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

STUCK_S = 1.5
"""An excited axis whose encoder repeats one value this long, before it is known how long it may."""
STUCK_FACTOR = 3.0
"""Afterwards: three times the longest stand seen at a small share of the amplitude, where friction and
coarse counts hold an axis longest."""
STUCK_PERIODS = 0.25
"""And never below a quarter period of the slowest line. A mass under a sinusoidal torque of amplitude A with
Coulomb friction F stops where A·(cos φ₀ − cos φ) = F·(φ − φ₀), sin φ₀ = F/A, and breaks loose at π + φ₀: it
stands for a quarter period at F = 0.87·A, and from there on friction has nearly won. While an encoder is dead
its axis goes on with the planned torque: in a quarter period of the slowest line it gets π/2 times the
planned travel of that line further than it would have."""
LIFE_CHANGES = 100
LIFE_FACTOR, LIFE_LEAST_S = 5.0, 0.25
"""A held axis whose encoder changed at least 100 times in one period of a periodic excitation must go on
changing: five times the longest stand of that period, and 0.25 s, is too long. Were the changes a Poisson
process, the longest stand among n would be ln(n) of its time constants and five times that would come
n·exp(−5·ln n) = n⁻⁴ times a period: once in 10⁸ periods at n = 100."""


class Standing:
    """How long each encoder has shown one value.

    A stand is the time between samples that came with consecutive SYNCs. What lies before or after a lost
    sample or a skipped slot counts for nothing: nobody knows what the encoder did meanwhile.
    """

    def __init__(self, names: list[str], cycle_s: float) -> None:
        self._names, self._cycle = names, cycle_s
        count = len(names)
        self._last: list[float | None] = [None] * count
        self._seen: list[tuple[int, float] | None] = [None] * count
        self._still = [0.0] * count
        self._longest = [0.0] * count
        self._allowed = [STUCK_S] * count
        self._least = 0.0
        self.excited: set[int] = set()
        """Axes that must move."""
        self._living: set[int] = set()
        self._learning = 0
        self._changes = [0] * count
        self._pause = [0.0] * count

    def settle(self) -> None:
        """The excitation changed: stands begin anew."""
        self._still = [0.0] * len(self._still)

    def slowest(self, lowest_hz: float) -> None:
        """The slowest line of the excitation from here on [Hz]."""
        self._least = STUCK_PERIODS / lowest_hz if lowest_hz > 0 else STUCK_S

    def forget(self) -> None:
        """Another excitation is tried at a small amplitude: until it is learned, an axis may stand long."""
        self._allowed = [STUCK_S] * len(self._allowed)

    def learn(self, axes: set[int]) -> None:
        """From here on, these axes may stand three times as long as they have stood while excited."""
        for i in axes:
            self._allowed[i] = min(max(STUCK_FACTOR * self._longest[i], 5 * self._cycle), STUCK_S)

    def expect_life(self, axes: set[int], cycles: int) -> None:
        """These held axes feel a periodic excitation from here on; learn from ``cycles`` how they do."""
        self._living, self._learning = set(axes), cycles
        for i in axes:
            self._still[i] = self._pause[i] = 0.0
            self._changes[i] = 0

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop where an encoder has stood too long."""
        learning = self._learning > 0
        if learning:
            self._learning -= 1
        for i in self.excited | self._living if self._living else self.excited:
            if not sample.fresh[i]:
                continue
            position, before = sample.position[i], self._seen[i]
            self._seen[i] = (sample.slot, sample.time)
            if position != self._last[i]:
                self._last[i] = position
                self._still[i] = 0.0
                self._changes[i] += learning
                continue
            if before is None or sample.slot != before[0] + 1:
                continue
            self._still[i] = still = self._still[i] + sample.time - before[1]
            if i in self.excited:
                self._longest[i] = max(still, self._longest[i])
                if still > max(self._allowed[i], self._least):
                    raise SafetyStop(
                        f"axis {self._names[i]}: the encoder has shown one value for "
                        f"{still:.2g} s of shaking",
                        way_out="the encoder is stuck, the brake is closed, or friction is above the torque",
                        code="stands",
                        axis=self._names[i],
                    )
            elif learning:
                self._pause[i] = max(still, self._pause[i])
            elif self._changes[i] >= LIFE_CHANGES and still > max(LIFE_FACTOR * self._pause[i], LIFE_LEAST_S):
                raise SafetyStop(
                    f"axis {self._names[i]}: the encoder of this held axis trembled with the shaking of the "
                    f"others and has now shown one value for {still:.2g} s",
                    way_out="the encoder is stuck or a brake has closed",
                    code="halted",
                    axis=self._names[i],
                )
