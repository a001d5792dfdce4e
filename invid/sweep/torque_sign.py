"""Watch whether the torque that a drive shows goes on following the torque that it is asked for."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

MEMORY_S, MEMORY_CYCLES = 0.05, 25
"""Time constant of what is remembered: a sign that turns is seen within one of it. After a pause nothing is
judged by fewer cycles."""
LAGS = 12
"""Cycles by which 0x6077 may follow. Where the last of them fits best the lag is not known, and nothing is
judged: a sinusoid that is half a period late looks like one of the wrong sign."""
FOLLOWS, OPPOSES = 0.5, -0.5
"""Shown over asked torque: a drive that obeys shows 1 at its lag, one whose sign has turned -1."""
SEEN = 0.02
"""Share of rated torque (rms) from which something is judged: four times the noise of 0x6077."""


class TorqueSign:
    """Watch over shown against asked torque of each axis, at each lag, over the last moments."""

    def __init__(self, names: Sequence[str], rated_torque: Sequence[float], cycle_s: float) -> None:
        self._names = list(names)
        self._least = [(SEEN * rated) ** 2 for rated in rated_torque]
        self._keep = 1.0 - cycle_s / max(MEMORY_S, MEMORY_CYCLES * cycle_s)
        self._known: list[int | None] = [None] * len(names)
        self.forget()

    def forget(self) -> None:
        """Forget the last moments, in which nothing was asked; lags that are known stay known."""
        count = len(self._names)
        self._asked: list[deque[float]] = [deque([0.0] * LAGS, maxlen=LAGS) for _ in range(count)]
        self._power = [[0.0] * LAGS for _ in range(count)]
        self._common = [[0.0] * LAGS for _ in range(count)]
        self._quiet = [LAGS] * count
        self._count = [0] * count
        self._slot: int | None = None

    def check(self, sample: Sample, asked: Sequence[float]) -> None:
        """Raise SafetyStop where an axis that followed shows the opposite of what it is asked for."""
        if self._slot is not None and sample.slot != self._slot + 1:
            self.forget()  # the drive went on with its last torque meanwhile
        self._slot = sample.slot
        keep = self._keep
        for i, value in enumerate(asked):
            self._quiet[i] = 0 if value else self._quiet[i] + 1
            if self._quiet[i] > LAGS:
                self._count[i] = 0
                continue
            past, power, common = self._asked[i], self._power[i], self._common[i]
            past.appendleft(value)  # some drives show at SYNC what they were sent just before it
            if sample.fresh[i]:
                shown = sample.torque[i]
                self._count[i] += 1
                for k, before in enumerate(past):
                    power[k] = keep * power[k] + (1.0 - keep) * before * before
                    common[k] = keep * common[k] + (1.0 - keep) * before * shown
                if min(power) > self._least[i] and self._count[i] >= MEMORY_CYCLES:
                    self._judge(i, [c / p for c, p in zip(common, power, strict=True)])

    def _judge(self, axis: int, slopes: list[float]) -> None:
        best = max(range(LAGS), key=slopes.__getitem__)
        if slopes[best] > FOLLOWS:
            self._known[axis] = best if best < LAGS - 1 else None
            return
        known = self._known[axis]
        if known is not None and slopes[known] < OPPOSES:
            raise SafetyStop(
                f"axis {self._names[axis]}: the torque that its drive shows (0x6077) followed the one that "
                f"it is asked for and is now opposed to it ({slopes[known]:.2g} times)",
                way_out="the drive or its wiring has changed: find out before anything moves again",
                code="torque_turned",
                axis=self._names[axis],
            )
