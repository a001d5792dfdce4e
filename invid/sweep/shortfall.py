"""Whether a drive gives less torque than it is asked for, or the opposite, by what it shows itself.

Of the torque asked for over the last ``LAGS`` cycles the least counts, in its direction: whatever 0x6077
lags, it shows at least that, less a share for its scale and its noise. What is missing is summed up over time
(CUSUM): an impulse, the speed that a load has gained by it. A healthy drive is on the other side of the
allowance in every cycle, six deviations of its noise away, so its sum stays zero. An axis without a load may
be given less, but no torque of the other sign once it has shown what it was asked for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

LAGS = 12
"""Cycles by which 0x6077 may follow."""
SCALE, LEARNT = 0.25, 0.08
"""Share of the asked torque that may be missing: what the trial of the signs lets pass, and once its scale
was seen."""
NOISE = 0.03
"""Of rated torque: six deviations of the 0.5 % that drives' current sensing has."""
LEARN_S = 1.0
TURNED = -0.5
"""Shown over asked torque: 1 of a drive that obeys, -1 where a sign has turned."""
IMPULSE_S = 0.0015
"""Sum at which a run ends, over rated torque: a load of rated torque that gets nothing has gained that in 2
ms."""
HELD_IMPULSE_S, LEAST_WEIGHT = 0.03, 0.1
"""The same for an axis that its drive holds, over its weight, or a tenth of rated torque: a loop that takes
over builds its torque up in 20 ms."""
OPENS_S, OPENS_AGAIN = 5.0, 1.5
"""A brake that opens later is not known; it may take so much longer the next time."""
POWER_MASK, ENERGISED = 0x4F, frozenset({0x07, 0x0F})
"""Of 0x6041 (CiA 402): operation enabled and quick stop active, or fault reaction active."""
STILL_COUNTS = 1.5
"""Counts that an encoder which is dead shows at most."""


def is_energised(status: int) -> bool:
    """Whether a drive with that statusword gives torque."""
    return status & POWER_MASK in ENERGISED


class _Axis:
    def __init__(self) -> None:
        self.asked: deque[float] = deque(maxlen=LAGS)
        self.due = self.shown = self.seconds = self.missing = 0.0

    def forget(self) -> None:
        self.asked.clear()
        self.missing = 0.0


class Shortfall:
    """Watch over shown against asked torque of the axes whose loops the master closes."""

    def __init__(
        self, names: Sequence[str], rated_torque: Sequence[float], torque_unit: str, cycle_s: float
    ) -> None:
        self._names, self._rated, self._unit, self._cycle = (
            list(names),
            list(rated_torque),
            torque_unit,
            cycle_s,
        )
        self._axes = [_Axis() for _ in names]
        self._slot: int | None = None

    def forget(self) -> None:
        """Forget the last moments; scales that were seen stay known."""
        self._slot = None
        for axis in self._axes:
            axis.forget()

    def check(self, sample: Sample, asked: Sequence[float], loaded: Collection[int]) -> None:
        """Raise SafetyStop where a drive gives less than it is asked for, or the opposite; 0: nothing is
        asked."""
        if self._slot is not None and sample.slot != self._slot + 1:
            self.forget()
        self._slot = sample.slot
        for i, axis in enumerate(self._axes):
            if asked[i] == 0.0:
                axis.forget()
                continue
            axis.asked.append(asked[i])
            if sample.fresh[i] and len(axis.asked) == LAGS:
                self._judge(i, axis, sample.torque[i], i in loaded)

    def _judge(self, i: int, axis: _Axis, torque: float, is_loaded: bool) -> None:
        sign = 1.0 if axis.asked[-1] > 0 else -1.0
        due, shown, rated = min(sign * a for a in axis.asked), sign * torque, self._rated[i]
        if due <= NOISE * rated:
            axis.missing = 0.0
            return
        learnt = axis.seconds >= LEARN_S
        scale = min(1.0, axis.shown / axis.due) if learnt else 1.0
        least = due * scale * (1.0 - (LEARNT if learnt else SCALE)) if is_loaded else 0.0
        axis.missing = max(0.0, axis.missing + (least - NOISE * rated - shown) * self._cycle)
        if not learnt and not is_loaded and axis.missing > 0.0:
            axis.due = axis.shown = axis.seconds = axis.missing = 0.0  # a display that lags shows no sign
        elif axis.missing == 0.0 and not learnt:
            axis.due, axis.shown = axis.due + due, axis.shown + min(shown, due)
            axis.seconds += self._cycle
        if axis.missing <= IMPULSE_S * rated:
            return
        has_turned = shown < TURNED * due
        raise SafetyStop(
            f"axis {self._names[i]}: its drive shows {shown:.3g} {self._unit} and is asked for {due:.3g} at "
            "least" + (": the torque (0x6077) that followed is now opposed to it" if has_turned else ""),
            way_out="the drive or its wiring has changed: find out before anything moves again"
            if has_turned
            else "it limits its torque by itself (I²t, temperature, 0x60E0, 0x60E1, supply): read its "
            "error memory; a load is not held by that",
            code="torque_turned" if has_turned else "no_torque",
            axis=self._names[i],
        )


class HeldTorque:
    """Watch over the torque of loaded axes that their drives hold while their encoders show no motion.

    A dead encoder shows a drive no error, so its loop gives no torque, and the load falls unseen.
    """

    def __init__(self, rated_torque: Sequence[float], counts: Sequence[float], cycle_s: float) -> None:
        """``counts``: position of one count of each axis."""
        self._rated, self._counts, self._cycle = list(rated_torque), list(counts), cycle_s
        count = len(self._rated)
        self._place: list[float | None] = [None] * count
        self._missing = [0.0] * count
        self._since: list[float | None] = [None] * count
        """When each axis was last enabled."""
        self._first: list[list[tuple[float, float]]] = [[] for _ in range(count)]
        """Time and torque of the first seconds after that, until it is known when its brake opens."""
        self._opens: dict[int, float] = {}
        self.grips: dict[int, float] = {}
        """Friction that the trial of an axis showed [N·m or N]: where that holds it its drive's torque may be
        anything within twice as much. Infinite where it was moved one way only."""

    def missing(self, sample: Sample, weights: Mapping[int, float], held: Collection[int]) -> list[int]:
        """Which ``held`` axes are not carried: axes by whose ``weights`` (torque) they are loaded."""
        found = []
        for i, status in enumerate(sample.status):
            if not sample.fresh[i]:
                continue
            if not is_energised(status):
                self._since[i] = None
            elif self._since[i] is None:
                self._since[i] = sample.time
            since = self._since[i]
            if since is not None and i not in self._opens and sample.time < since + OPENS_S:
                self._first[i].append((sample.time - since, sample.torque[i]))
        for i, weight in weights.items():
            if i not in self._opens:
                carried = (t for t, torque in self._first[i] if torque * weight > weight**2 / 2)
                self._opens[i] = next(carried, 0.0)
                self._first[i] = []
            since = self._since[i]
            if i not in held or since is None or sample.time < since + OPENS_AGAIN * self._opens[i]:
                self._missing[i] = 0.0
                continue
            if not sample.fresh[i]:
                continue
            place = self._place[i]
            if place is None or abs(sample.position[i] - place) > STILL_COUNTS * abs(self._counts[i]):
                self._place[i], self._missing[i] = sample.position[i], 0.0
            sign = 1.0 if weight > 0 else -1.0
            grip = 2 * self.grips.get(i, 0.0)
            short = abs(weight) * (1.0 - SCALE) - NOISE * self._rated[i] - grip - sign * sample.torque[i]
            self._missing[i] = max(0.0, self._missing[i] + short * self._cycle)
            if self._missing[i] > HELD_IMPULSE_S * max(abs(weight), LEAST_WEIGHT * self._rated[i]):
                found.append(i)
        return found
