"""A load beyond its torque limit is told from a wrong sign: by less torque.

A drive that yields at its limit has a load beyond it (or the limit is written in a wrong scale), or a sign
is wrong and it drives what it is to hold. With half the torque a load falls faster; what a wrong sign drives
gets slower. A load gets back what was written, never more: that is what the config permits, in the scale
that is stated. Its weight is remembered: the axis is refused from then on until the limit is raised.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.config import CellConfig
from invid.errors import SafetyStop
from invid.sweep.ports import Mode, Sample
from invid_drivers.cia402.axis import Drive
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.journal import Entry
from invid_drivers.cia402.mode_change import SettingWrite
from invid_drivers.cia402.objects import MAX_TORQUE
from invid_drivers.cia402.states import DriveState, state_of

AT_LIMIT, HALVED = 0.9, 0.6
"""Share of the limit that a drive shows which is held back by it, and by half of it."""
SAMPLES, LONG_S = 6, 0.03
"""Of each of the two accelerations, at least: short against what a load falls, and long against the counts of
an encoder."""
DECISIVE = 5.0
"""Standard deviations of what the counts of the encoder leave of their difference."""
PROBE_S = 0.15
"""Longest wait for the halved torque."""


@dataclass
class _Axis:
    """One axis whose limit was lowered, to so many thousandths."""

    wrote: int
    rows: list[tuple[float, float]] = field(default_factory=list)
    """(time, position) while its torque was what is looked at."""
    before: float | None = None
    """Acceleration at the limit, once that is known; from then on the limit is halved."""
    since: float = 0.0
    back: SettingWrite | None = None
    """What was written before, for a load or where nobody can tell."""
    is_load: bool = False


class WeightRelief:
    """Looks at axes that their drives hold at rest; made before they are enabled."""

    def __init__(
        self,
        config: CellConfig,
        drives: Sequence[Drive],
        cycle: Cycle,
        units: Sequence[tuple[float, float]],
        remember: Callable[[int, int], None],
    ) -> None:
        """``units``: position of a count [rad or m] and torque of a thousandth [N·m or N] of each axis;
        ``remember`` takes an axis and the thousandths that its load needs at least.
        """
        self.notes: list[str] = []
        """What a person must know of axes that yielded, and nobody knows why."""
        self._config, self._drives, self._cycle, self._remember = config, drives, cycle, remember
        self._counts = [abs(count) for count, _ in units]
        self._torque = [abs(torque) for _, torque in units]
        self.opposed: set[int] = set()
        """Axes that less torque makes slower: their drives drive what they are to hold."""
        self._axes = {
            i: _Axis(d.protection.torque_lowered)
            for i, d in enumerate(drives)
            if d.protection.torque_lowered is not None
        }

    @property
    def probing(self) -> set[int]:
        """Axes that are being looked at."""
        return {i for i, a in self._axes.items() if a.rows or a.before is not None}

    def look(self, sample: Sample, doubted: Sequence[bool]) -> None:
        """One cycle; ``doubted``: axes that may be loaded and were not seen to be held.

        SafetyStop where the load of one of them is beyond its limit, or its drive drives it.
        """
        for i, axis in list(self._axes.items()):
            if axis.back is not None:
                self._end(i, axis, axis.back, sample)
                continue
            if axis.before is not None and sample.time - axis.since > PROBE_S:
                self._give_back(i, axis, sample)
                continue
            held = self._cycle.modes[i] is Mode.HOLD and doubted[i]
            if not held or not sample.fresh[i] or state_of(sample.status[i]) != DriveState.OPERATION_ENABLED:
                axis.rows.clear()
                continue
            share = abs(sample.torque[i]) / (axis.wrote * self._torque[i])
            if axis.before is None:
                self._at_limit(i, axis, sample, share)
            else:
                self._at_half(i, axis, sample, share)

    def _at_limit(self, i: int, axis: _Axis, sample: Sample, share: float) -> None:
        if share < AT_LIMIT:
            axis.rows.clear()
            return
        axis.rows.append((sample.time, sample.position[i]))
        if not _is_long(axis.rows):
            return
        away = axis.rows[-1][1] - axis.rows[0][1]
        if away * sample.torque[i] >= 0 or abs(away) < SAMPLES * self._counts[i]:
            axis.rows.pop(0)
            return
        axis.before, axis.since = math.copysign(1.0, away) * _acceleration(axis.rows), sample.time
        axis.rows.clear()
        self._write(i, axis.wrote, max(1, axis.wrote // 2))

    def _at_half(self, i: int, axis: _Axis, sample: Sample, share: float) -> None:
        if share <= HALVED:
            axis.rows.append((sample.time, sample.position[i]))
        if not _is_long(axis.rows) or axis.before is None:
            return
        span = axis.rows[-1][0] - axis.rows[0][0]
        noise = self._counts[i] / math.sqrt(12) * math.sqrt(2 * 720 / len(axis.rows)) / span**2
        away = math.copysign(1.0, axis.rows[-1][1] - axis.rows[0][1])
        faster = away * _acceleration(axis.rows) - axis.before
        name = self._config.axes[i].name
        if faster < -DECISIVE * noise:
            self.opposed.add(i)
            raise SafetyStop(
                f"axis {name}: with half its torque it gets faster more slowly: its drive drives what it is "
                "to hold",
                way_out="a sign is wrong: compare the directions of motor and encoder in the drive",
                code="yields",
                axis=name,
            )
        if faster > DECISIVE * noise:
            axis.is_load = True
            self._give_back(i, axis, sample)

    def _give_back(self, i: int, axis: _Axis, sample: Sample) -> None:
        axis.back, axis.since = self._write(i, max(1, axis.wrote // 2), axis.wrote), sample.time

    def _end(self, i: int, axis: _Axis, back: SettingWrite, sample: Sample) -> None:
        """End the run once the load has what the config permits: on the way out no limit rises.

        Where nobody could tell what made the axis yield, the run goes on with the whole limit, which is said;
        the watch ends it if the axis yields again.
        """
        if not back.done and sample.time - axis.since < PROBE_S:
            return
        del self._axes[i]
        name = self._config.axes[i].name
        if not axis.is_load:
            kept = "given back" if back.done and back.refused is None else "not taken back, and is half"
            self.notes.append(
                f"axis {name}: it yielded to its torque limit when it was enabled, and half of the limit did "
                f"not tell within {PROBE_S:g} s whether to its load or to a wrong sign; the limit (0x6072, "
                f"{axis.wrote} ‰) was {kept}"
            )
            return
        self._remember(i, axis.wrote + 1)
        raise SafetyStop(
            f"axis {name}: its drive does not hold it within {axis.wrote} ‰ of rated torque, as the config "
            "limits it, and it sinks",
            way_out="support it, then compare 0x6076 with the motor's plate, or raise its torque limit",
            code="yields",
            axis=name,
        )

    def _write(self, i: int, before: int, value: int) -> SettingWrite:
        drive = self._drives[i]
        was, is_now = MAX_TORQUE.pack(before).hex(), MAX_TORQUE.pack(value).hex()
        drive.journal.note(Entry(drive.node_id, drive.serial, MAX_TORQUE.index, MAX_TORQUE.sub, was, is_now))
        return self._cycle.set_object(i, MAX_TORQUE, value)


def _is_long(rows: Sequence[tuple[float, float]]) -> bool:
    return len(rows) >= SAMPLES and rows[-1][0] - rows[0][0] >= LONG_S


def _acceleration(rows: Sequence[tuple[float, float]]) -> float:
    time, position = np.array(rows).T
    return 2.0 * float(np.polyfit(time - time.mean(), position, 2)[0])
