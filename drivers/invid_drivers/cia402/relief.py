"""A torque limit lowered below what a load takes would drop it: the drive's own comes back, in steps.

Never more than the drive was found with is written. Torque is compared in the drive's own thousandths,
so that a wrong scale, the likely reason, does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

from invid.config import CellConfig
from invid.sweep.ports import Event, Mode, Sample, Severity
from invid_drivers.cia402.axis import Drive
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.journal import Entry
from invid_drivers.cia402.objects import MAX_TORQUE
from invid_drivers.cia402.standstill import tolerances
from invid_drivers.cia402.states import DriveState, state_of

AT_LIMIT, SAMPLES = 0.9, 3
"""Share of the limit that a loop which is held back shows, with the noise of its sensor; samples in a row."""
STEP, SURE_S = 2, 0.3
"""The limit is doubled until the axis yields no more; said when that has lasted so long."""
STILL_SHARE = 0.002
"""It gives way: as a share of the window."""
HELD_S, CARRIED_S, CARRIES = 0.5, 0.1, 0.05
"""An axis that its drive has held still for so long, below the limit, has a limit that holds its weight: what
drives it to the limit later is a wrong sign or a person, and gets no more torque. Brakes of servo motors open
within 0.3 s, and until then nothing weighs on the drive: one that gives more than this share of its limit
carries it."""


class TorqueRelief:
    """Watches axes that their drives hold; made when they are enabled."""

    def __init__(
        self, config: CellConfig, drives: Sequence[Drive], cycle: Cycle, units: Sequence[tuple[float, float]]
    ) -> None:
        """``units``: position of a count [rad or m] and torque of a thousandth [N·m or N] of each axis."""
        self._config, self._drives, self._cycle = config, drives, cycle
        self._limits = [d.protection.torque_lowered for d in drives]
        self._torque = [abs(torque) for _, torque in units]
        self._still = tolerances(config, [count for count, _ in units], STILL_SHARE)
        self._start: list[float | None] = [None] * len(drives)
        self._seen = [0] * len(drives)
        self._stood: list[tuple[float, float] | None] = [None] * len(drives)
        """Instant and place from which each axis has stood below its limit."""
        self._given: dict[int, tuple[float, int]] = {}

    def look(self, sample: Sample, doubted: Sequence[bool]) -> None:
        """Give an axis that yields at its limit more, up to what was found; ``doubted``: may be loaded."""
        for i, limit in enumerate(self._limits):
            if limit is None or not doubted[i] or not sample.fresh[i]:
                continue
            held = self._cycle.modes[i] is Mode.HOLD and not self._cycle.changing
            wrote, found = limit
            start = self._start[i]
            if self._is_held(i, sample, held, wrote * self._torque[i]):
                self._limits[i] = None
                continue
            if start is None or not held or abs(sample.torque[i]) < AT_LIMIT * wrote * self._torque[i]:
                self._start[i], self._seen[i] = sample.position[i], 0
                self._report(i, sample)
                continue
            self._seen[i] += 1
            if self._seen[i] < SAMPLES or wrote >= found or abs(sample.position[i] - start) < self._still[i]:
                self._report(i, sample)
                continue
            self._given.setdefault(i, (sample.time, wrote))
            self._limits[i] = min(STEP * wrote, found), found
            self._start[i], self._seen[i] = sample.position[i], 0
            self._write(i, wrote, min(STEP * wrote, found))

    def _is_held(self, axis: int, sample: Sample, held: bool, limit: float) -> bool:
        """Whether its drive has been seen to hold it within the limit."""
        enabled = state_of(sample.status[axis]) is DriveState.OPERATION_ENABLED
        if not held or not enabled or abs(sample.torque[axis]) >= AT_LIMIT * limit:
            self._stood[axis] = None
            return False
        stood, place = self._stood[axis], sample.position[axis]
        if stood is None or abs(place - stood[1]) >= self._still[axis]:
            self._stood[axis] = sample.time, place
            return False
        carries = abs(sample.torque[axis]) > CARRIES * limit
        return sample.time - stood[0] >= (CARRIED_S if carries else HELD_S)

    def _write(self, axis: int, before: int, value: int) -> None:
        drive = self._drives[axis]
        was, is_now = MAX_TORQUE.pack(before).hex(), MAX_TORQUE.pack(value).hex()
        address = (drive.node_id, drive.serial, MAX_TORQUE.index, MAX_TORQUE.sub)
        drive.journal.add(Entry(*address, was, is_now))
        self._cycle.set_object(axis, MAX_TORQUE, value)

    def _report(self, axis: int, sample: Sample) -> None:
        """Once the drive holds: a stop before that would be made with a limit that drops the axis."""
        limit = self._limits[axis]
        if axis not in self._given or limit is None or sample.time - self._given[axis][0] < SURE_S:
            return
        _, first = self._given.pop(axis)
        self._limits[axis] = None
        name = self._config.axes[axis].name
        text = (
            f"axis {name}: its drive could not hold it within {first} ‰ of rated torque, as the config "
            f"limits it; 0x6072 is {limit[0]} ‰ now, {limit[1]} ‰ was found. Compare 0x6076 with the motor's "
            "plate, or raise the limit"
        )
        sample.events = [*sample.events, Event(Severity.DRIVE, text, name)]
