"""What the master watches every cycle, on excited and on held axes alike."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from invid.errors import BusError, DriveError, SafetyStop
from invid.numerics.arrays import Float64
from invid.sweep.drive_word import DriveWords
from invid.sweep.ports import Sample, Severity
from invid.sweep.stuck_encoder import Halting, Standing, Yielding

STATE_MASK, OPERATION_ENABLED = 0x6F, 0x27
"""State bits of 0x6041 (CiA 402)."""

VELOCITY_CYCLES = 4
"""Baseline of the velocity: four cycles halve the noise of two encoder counts twice."""
STAMP_CYCLES = 0.2
"""When SYNC was on the wire is known to a fifth of a cycle on a busy computer: what is surely too fast is so
over a way that took that much longer. Five per cent over four cycles."""
TORQUE_MARGIN = 1.1
TORQUE_NOISE = 0.03
"""0x6077 may read 10 % over the limit and 3 % of rated torque: six standard deviations of the 0.5 % that
drives' current sensing has (empirical, from the vendors' figures in notes)."""
REST_SHARE = 0.1
"""Of the window: an axis that its drive holds at rest and that goes further is not held. A stiff loop yields
by a hundredth of that to a person who leans on it; one whose torque limit is lowered too far by a few steps
of 0.2 % until it has the drive's own again (empirical)."""
ENERGY_WINDOW_S = 0.25
ENERGY_GROWTH = 1.25
ENERGY_WINDOWS = 4
ENERGY_SHARE = 0.0025
"""An unstable hold: the held axes' Σ(v/v_limit)² grows by a quarter in each of four windows of 0.25 s
and has passed 5 % of the velocity limit (0.0025 = 0.05²). A linear structure driven at constant
amplitude stops growing; 1.25⁴ = 2.4 in a second is faster than any mode in a robot rings up and slower
than the growth of the unstable P holds measured on the case study (0.78 /s at K_R = 1000 is 4.8 in
energy). Empirical."""


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


@dataclass
class Statistics:
    """What was seen; ends up in the result."""

    cycles: int = 0
    skipped_slots: int = 0
    missed_tpdos: list[int] = field(default_factory=list)
    peak_travel: list[float] = field(default_factory=list)
    peak_velocity: list[float] = field(default_factory=list)
    peak_torque: list[float] = field(default_factory=list)


class Watch:
    """Checks one sample after another; raises on the first that must stop the motion."""

    def __init__(
        self, limits: list[AxisLimits], *, cycle_s: float, missed_tpdos: int, overrun_cycles: int
    ) -> None:
        self._limits = limits
        self._cycle = cycle_s
        self._most_missed, self._most_skipped = missed_tpdos, overrun_cycles
        count = len(limits)
        self._missed = [0] * count
        self._last_slot: int | None = None
        self._origin: list[float] | None = None
        self._history: list[deque[tuple[float, float]]] = [
            deque(maxlen=VELOCITY_CYCLES + 1) for _ in range(count)
        ]
        self._energy = 0.0
        self._energy_cycles = 0
        self._energies: list[float] = []
        names = [a.name for a in limits]
        self.standing = Standing(names, cycle_s)
        self.words = DriveWords(names, cycle_s)
        self.halting = Halting(names, [a.resolution for a in limits], limits[0].unit, cycle_s)
        self._yielding = Yielding(
            names,
            [a.torque for a in limits],
            [a.velocity for a in limits],
            limits[0].unit,
        )
        self.held: set[int] = set()
        """Axes whose energy is watched for growth."""
        self.led: set[int] = set()
        """Axes whose loops the master closes."""
        self.resting: set[int] = set()
        """Axes that their drives hold while nothing is shaken."""
        self._travel, self._speed, self._torque = [0.0] * count, [0.0] * count, [0.0] * count
        self._lost = [0] * count
        self.statistics = Statistics(0, 0, self._lost, self._travel, self._speed, self._torque)

    def start(self, position: list[float]) -> None:
        """Windows are around these positions from now on."""
        self._origin = list(position)

    def permit(self, axis: int, velocity: float) -> None:
        """Another limit for the velocity of one axis, from here on."""
        self._limits[axis] = replace(self._limits[axis], velocity=velocity)
        self._speed[axis] = min(self._speed[axis], velocity)  # only what is faster than ever is looked at

    @property
    def peaks(self) -> Float64:
        """(3, M) largest travel, velocity and torque so far."""
        return np.array([self._travel, self._speed, self._torque])

    def settle(self) -> None:
        """Excitation changed: growth of energy is judged afresh."""
        self._energies.clear()
        self._energy, self._energy_cycles = 0.0, 0
        self.standing.settle()

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop, DriveError or BusError where the motion must stop."""
        if sample.events:
            self._events(sample)
        self.statistics.cycles += 1
        self._check_slot(sample.slot)
        origin = self._origin
        if origin is None:
            return
        energy = 0.0
        for i, limit in enumerate(self._limits):
            if not sample.fresh[i]:
                self._missing(i)
                continue
            self._missed[i] = 0
            if sample.status[i] & STATE_MASK != OPERATION_ENABLED:
                raise DriveError(
                    f"axis {limit.name}: the drive left operation enabled (statusword "
                    f"0x{sample.status[i]:04X}{', fault' if sample.status[i] & 0x08 else ''})",
                    way_out="read its error memory, find the cause, reset it there",
                    code="drive_left",
                    axis=limit.name,
                )
            self._check_travel(i, limit, abs(sample.position[i] - origin[i]))
            speed = self._check_speed(i, limit, sample.time, sample.position[i])
            if speed > 0 and i in self.held:
                energy += (speed / limit.velocity) ** 2
            self._check_torque(i, limit, abs(sample.torque[i]))
        self._yielding.check(sample, self.led)
        self._watch_energy(energy)
        self.words.check(sample)
        self.halting.check(sample)
        self.standing.check(sample)

    def _check_slot(self, slot: int) -> None:
        if self._last_slot is not None:
            skipped = slot - self._last_slot - 1
            if skipped:
                self.statistics.skipped_slots += skipped
                if skipped > self._most_skipped:
                    raise SafetyStop(
                        f"the computer was late for {skipped} SYNC slots in a row "
                        f"({skipped * self._cycle * 1e3:.0f} ms)",
                        way_out="stop other programs on it or lengthen bus.cycle_s",
                        code="computer_late",
                    )
        self._last_slot = slot

    def _check_travel(self, i: int, limit: AxisLimits, travel: float) -> None:
        if travel <= self._travel[i]:
            return
        self._travel[i] = travel
        if travel > limit.position:
            raise SafetyStop(
                f"axis {limit.name}: position left its window: {travel:.4g} {limit.unit} from "
                f"the start, limit {limit.position:g}",
                way_out="lower the amplitude or widen the window",
                code="position_window",
                axis=limit.name,
            )
        if i in self.resting and travel > REST_SHARE * limit.position:
            raise SafetyStop(
                f"axis {limit.name}: moved by {travel:.3g} {limit.unit} though its drive is to "
                "hold it at rest",
                way_out="somebody moves it, its load is beyond the drive's torque limit, or a sign "
                "is wrong in the drive",
                code="not_held",
                axis=limit.name,
            )

    def _check_speed(self, i: int, limit: AxisLimits, time: float, position: float) -> float:
        """Speed over the last cycles less one count of the encoder; 0 where there is only one sample."""
        # Samples that came, each with its own instant: a stale one would pass for a leap.
        history = self._history[i]
        history.append((time, position))
        then, before = history[0]
        dt = time - then
        if dt <= 0:
            return 0.0
        speed = (abs(position - before) - limit.resolution) / dt
        if speed > self._speed[i]:
            self._speed[i] = speed
            if speed * dt > limit.velocity * (dt + STAMP_CYCLES * self._cycle):
                raise SafetyStop(
                    f"axis {limit.name}: velocity {speed:.4g} {limit.unit}/s, limit {limit.velocity:g}",
                    way_out="lower the amplitude, or look at the encoder if the axis did not move so fast",
                    code="velocity",
                    axis=limit.name,
                )
        return speed

    def _check_torque(self, i: int, limit: AxisLimits, torque: float) -> None:
        if torque <= self._torque[i]:
            return
        self._torque[i] = torque
        if torque > TORQUE_MARGIN * limit.torque + TORQUE_NOISE * limit.rated_torque:
            raise SafetyStop(
                f"axis {limit.name}: torque {torque:.4g} {limit.torque_unit}, limit "
                f"{limit.torque:g}: the drive gives more than it was asked for",
                way_out="check rated_torque and the drive's tuning",
                code="torque",
                axis=limit.name,
            )

    def _missing(self, i: int) -> None:
        self._lost[i] += 1
        self._missed[i] += 1
        if self._missed[i] >= self._most_missed:
            raise DriveError(
                f"axis {self._limits[i].name}: no position for {self._missed[i]} cycles in a row",
                way_out="check its cable, its supply and the bus",
                code="no_answer",
                axis=self._limits[i].name,
            )

    def _events(self, sample: Sample) -> None:
        for event in sample.events:
            if event.severity is Severity.DRIVE:
                raise DriveError(event.text, code="drive_fault", axis=event.axis)
            if event.severity is Severity.BUS:
                raise BusError(event.text, code="bus")

    def _watch_energy(self, energy: float) -> None:
        self._energy += energy
        self._energy_cycles += 1
        if self._energy_cycles * self._cycle < ENERGY_WINDOW_S:
            return
        mean = self._energy / self._energy_cycles
        self._energy, self._energy_cycles = 0.0, 0
        seen = self._energies
        seen.append(mean)
        if len(seen) > ENERGY_WINDOWS + 1:
            del seen[0]
        if len(seen) <= ENERGY_WINDOWS or seen[-1] <= ENERGY_SHARE:
            return
        if all(after > ENERGY_GROWTH * before for before, after in pairwise(seen)):
            names = ", ".join(self._limits[i].name for i in sorted(self.held))
            raise SafetyStop(
                f"the motion of the held axes ({names}) keeps growing: a hold is unstable",
                way_out="use hold mode 'drive', or master_pd with a lower gain",
                code="hold_unstable",
                axis=self._limits[min(self.held)].name if len(self.held) == 1 else None,
            )
