"""Encoders that stand still although they should not: stuck, or behind a brake that has closed."""

from __future__ import annotations

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

STUCK_S = 1.5
"""An excited axis whose encoder repeats one value this long, before it is known how long it may."""
STUCK_FACTOR, STUCK_LEAST_S = 3.0, 0.05
"""Afterwards: three times the longest stand seen at a small share of the amplitude, where friction and
coarse counts hold an axis longest, and never below 50 ms."""
LIFE_CHANGES = 100
LIFE_FACTOR, LIFE_LEAST_S = 5.0, 0.25
"""A held axis whose encoder changed at least 100 times in one period of a periodic excitation must go on
changing: five times the longest stand of that period, and 0.25 s, is too long. Were the changes a Poisson
process, the longest stand among n would be ln(n) of its time constants and five times that would come
n·exp(−5·ln n) = n⁻⁴ times a period: once in 10⁸ periods at n = 100."""


class Standing:
    """How long each encoder has shown one value. Samples that did not come count for nothing."""

    def __init__(self, names: list[str], cycle_s: float) -> None:
        self._names, self._cycle = names, cycle_s
        count = len(names)
        self._last: list[float | None] = [None] * count
        self._still = [0] * count
        self._longest = [0] * count
        self._allowed = [max(1, round(STUCK_S / cycle_s))] * count
        self.excited: set[int] = set()
        """Axes that must move."""
        self._living: set[int] = set()
        self._learning = 0
        self._changes = [0] * count
        self._pause = [0] * count

    def settle(self) -> None:
        """The excitation changed: stands begin anew."""
        self._still = [0] * len(self._still)

    def learn(self, axes: set[int]) -> None:
        """From here on, these axes may stand three times as long as they have stood while excited."""
        for i in axes:
            allowed = max(STUCK_FACTOR * self._longest[i] * self._cycle, STUCK_LEAST_S)
            self._allowed[i] = max(5, round(min(allowed, STUCK_S) / self._cycle))

    def expect_life(self, axes: set[int], cycles: int) -> None:
        """These held axes feel a periodic excitation from here on; learn from ``cycles`` how they do."""
        self._living, self._learning = set(axes), cycles
        for i in axes:
            self._still[i] = self._changes[i] = self._pause[i] = 0

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop where an encoder has stood too long."""
        learning = self._learning > 0
        if learning:
            self._learning -= 1
        for i in self.excited | self._living if self._living else self.excited:
            if not sample.fresh[i]:
                continue
            position = sample.position[i]
            if position != self._last[i]:
                self._last[i] = position
                self._still[i] = 0
                self._changes[i] += learning
                continue
            self._still[i] = still = self._still[i] + 1
            if i in self.excited:
                self._longest[i] = max(still, self._longest[i])
                if still > self._allowed[i]:
                    raise SafetyStop(
                        f"axis {self._names[i]}: the encoder has shown one value for "
                        f"{still * self._cycle:.2g} s of shaking; the encoder is stuck, the brake is closed, "
                        "or friction is above the torque"
                    )
            elif learning:
                self._pause[i] = max(still, self._pause[i])
            elif self._changes[i] >= LIFE_CHANGES and still > max(
                LIFE_FACTOR * self._pause[i], LIFE_LEAST_S / self._cycle
            ):
                raise SafetyStop(
                    f"axis {self._names[i]}: the encoder of this held axis trembled with the shaking of the "
                    f"others and has now shown one value for {still * self._cycle:.2g} s; the encoder is "
                    "stuck or a brake has closed"
                )
