"""Check the true limits of every axis in every cycle, whoever makes it.

A cell that watches itself has one of these from before the first axis is enabled until the last one is off;
for any other it belongs to the sweep's watch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from invid.config import CellConfig
from invid.errors import BusError, DriveError, SafetyStop
from invid.numerics.arrays import Float64
from invid.sweep.axis_estimator import AxisEstimator, AxisLimits, Fall, Kind
from invid.sweep.obedience import Obedience
from invid.sweep.ports import Sample, Severity
from invid.sweep.shortfall import HeldTorque, Shortfall, is_energised
from invid.sweep.stuck_encoder import Unmoved, Yielding
from invid.wording.sentence import sentence

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


@dataclass
class Statistics:
    """Largest values and counts that a run has seen; they end up in the result."""

    cycles: int = 0
    skipped_slots: int = 0
    missed_tpdos: list[int] = field(default_factory=list)
    peak_travel: list[float] = field(default_factory=list)
    peak_velocity: list[float] = field(default_factory=list)
    peak_torque: list[float] = field(default_factory=list)


class Bounds:
    """Checks one sample after another; raises on the first that must stop the motion."""

    def __init__(
        self, limits: list[AxisLimits], *, cycle_s: float, missed_tpdos: int, overrun_cycles: int
    ) -> None:
        self.limits = limits
        self._fastest = [a.velocity for a in limits]
        self._cycle = cycle_s
        self._most_missed, self._most_skipped = missed_tpdos, overrun_cycles
        count = len(limits)
        self._missed = [0] * count
        self._last_slot: int | None = None
        self.origin: list[float] | None = None
        self._history: list[deque[tuple[float, float]]] = [
            deque(maxlen=VELOCITY_CYCLES + 1) for _ in range(count)
        ]
        self.estimators = [AxisEstimator(a, cycle_s) for a in limits]
        """Place, speed and standing of each axis."""
        self._yielding = Yielding(self.estimators)
        self.falls: dict[int, Fall] = {}
        """Axes that were to stand and did not, from the sample on that ended the run."""
        self.blind: set[int] = set()
        """Axes whose encoders were seen to be dead: no loop that they close holds."""
        self._shortfall = Shortfall(
            [a.name for a in limits], [a.rated_torque for a in limits], limits[0].torque_unit, cycle_s
        )
        self.held_torque = HeldTorque(
            [a.rated_torque for a in limits], [a.resolution for a in limits], cycle_s
        )
        self.unmoved = Unmoved(
            [a.name for a in limits],
            [a.resolution for a in limits],
            [a.position for a in limits],
            cycle_s,
        )
        """Torque that must have moved axes whose encoders stand."""
        self.obedience = Obedience([a.name for a in limits], cycle_s)
        """Demand against motion."""
        self.led: set[int] = set()
        """Axes whose loops the master closes."""
        self.weights: dict[int, float] = {}
        """Torque that holds each loaded axis: with less it falls; of other axes it is a warning."""
        self.resting: set[int] = set()
        """Axes that their drives hold while nothing is shaken."""
        self._all = set(range(count))
        self.near: dict[int, tuple[float, float]] = {}
        """Where axes stood that are not shaken yet, and how far from there they may go, as announced."""
        self.speeds = [0.0] * count
        """Speed of each axis over the last cycles, less one count of the encoder; 0 where it is not known."""
        self.count_anew()

    def count_anew(self) -> None:
        """Start statistics and peaks anew."""
        count = len(self.limits)
        self._travel, self._speed, self._torque = [0.0] * count, [0.0] * count, [0.0] * count
        self._lost = [0] * count
        self.statistics = Statistics(0, 0, self._lost, self._travel, self._speed, self._torque)

    def start(self, position: list[float]) -> None:
        """Centre the windows around these positions from now on."""
        self.blind = set()
        self.origin = list(position)

    def pause(self) -> None:
        """Note that no cycles were made on purpose: what comes next is compared with nothing before."""
        self._last_slot = None
        for history in self._history:
            history.clear()
        for estimator in self.estimators:
            estimator.begin()
        self._shortfall.forget()
        self.unmoved.forget()
        self.obedience.forget()

    def permit(self, axis: int, velocity: float) -> None:
        """Set another limit for the velocity of one axis, from here on; never above that of the config."""
        velocity = min(velocity, self._fastest[axis])
        self.limits[axis] = replace(self.limits[axis], velocity=velocity)
        self.estimators[axis].limits = self.limits[axis]
        self._speed[axis] = min(self._speed[axis], velocity)  # only what is faster than ever is looked at

    @property
    def peaks(self) -> Float64:
        """(3, M) largest travel, velocity and torque so far."""
        return np.array([self._travel, self._speed, self._torque])

    def observe(self, sample: Sample) -> None:
        """Take in where every axis is; what its encoder or its torque gives away is in ``blind``."""
        for i, estimator in enumerate(self.estimators):
            estimator.expect_standing(i not in self.led)
            if sample.fresh[i]:
                quiet = bool(self.resting)
                estimator.take(sample.time, sample.position[i], sample.torque[i], quiet=quiet)
                if estimator.leapt:
                    self.blind.add(i)  # no loop that this encoder closes holds

    def uncarried(self, sample: Sample, axes: Collection[int]) -> list[int]:
        """Loaded ones of these axes that their drives do not carry, though their encoders show no motion."""
        held = {i for i in axes if sample.fresh[i] and is_energised(sample.status[i])}
        return self.held_torque.missing(sample, self.weights, held)

    def check(self, sample: Sample, asked: Sequence[float] | None = None) -> None:
        """Raise SafetyStop, DriveError or BusError where the motion must stop.

        ``asked``: torque that each axis in torque mode was sent with this SYNC; 0 where its drive holds it.
        """
        self.observe(sample)
        if sample.events:
            self._events(sample)
        self.statistics.cycles += 1
        self._check_slot(sample)
        origin = self.origin
        if origin is None:
            return
        self._check_leaps(sample)
        for i, limit in enumerate(self.limits):
            if not sample.fresh[i]:
                if is_energised(sample.status[i]):
                    self._missing(i, sample)
                continue
            self._missed[i] = 0
            self._check_travel(i, limit, abs(sample.position[i] - origin[i]))
            self.speeds[i] = self._check_speed(i, limit, sample.time, sample.position[i])
            self._check_torque(i, limit, abs(sample.torque[i]))
            if i in self.near:
                self._check_announced(limit, sample.position[i], *self.near[i])
        self._check_standing(sample)
        self._yielding.check(sample, self.led)
        if asked is not None:
            self._check_given(sample, asked)

    def _check_slot(self, sample: Sample) -> None:
        slot = sample.slot
        if self._last_slot is not None:
            skipped = slot - self._last_slot - 1 - sample.listened
            if skipped:
                self.statistics.skipped_slots += skipped
                if skipped > self._most_skipped:
                    raise SafetyStop(
                        sentence(
                            "the computer was late for {slots} SYNC slots in a row ({ms:.0f} ms)",
                            slots=skipped,
                            ms=skipped * self._cycle * 1e3,
                        ),
                        way_out="stop other programs on it or lengthen bus.cycle_s",
                        code="computer_late",
                    )
        self._last_slot = slot

    def _check_leaps(self, sample: Sample) -> None:
        for i, (limit, estimator) in enumerate(zip(self.limits, self.estimators, strict=True)):
            if estimator.leapt and sample.fresh[i]:
                raise SafetyStop(
                    f"axis {limit.name}: its encoder leapt by {estimator.leapt:.3g} {limit.unit} between two "
                    f"samples, further than the axis goes at {limit.velocity:.3g} {limit.unit}/s",
                    way_out="look at the encoder, its cable and its shield, and at whether its drive sets "
                    "0x6064 anew",
                    code="leapt",
                    axis=limit.name,
                )

    def _check_standing(self, sample: Sample) -> None:
        standing = self._all - self.led
        for i in self.uncarried(sample, standing):
            self.blind.add(i)
            raise SafetyStop(
                f"axis {self.limits[i].name}: it took {abs(self.weights[i]):.3g} to hold it, its drive shows "
                f"{abs(sample.torque[i]):.3g}, and the encoder stands still",
                way_out="the encoder is dead and its load falls, or somebody supports it: support it, "
                "then look at the encoder",
                code="halted",
                axis=self.limits[i].name,
            )
        found = {i: self.estimators[i].fall for i in standing if sample.fresh[i]}
        self.falls = {i: f for i, f in found.items() if f is not None and is_energised(sample.status[i])}
        for i, fall in self.falls.items():
            limit = self.limits[i]
            driven = fall.kind is Kind.DRIVEN
            raise SafetyStop(
                f"axis {limit.name}: is to stand and gets faster, by {fall.acceleration:.3g} "
                f"{limit.unit}/s², "
                f"while its drive shows {abs(fall.torque):.3g} {limit.torque_unit}: "
                + (fall.kind.value if driven or not fall.at_limit else "all that its limit permits"),
                way_out="a sign is wrong: compare the directions of motor and encoder in the drive"
                if driven
                else "support it; then compare 0x6076 with the motor's plate, raise its torque limit, or see "
                "what the drive itself limits (I²t, 0x60E0, 0x60E1)",
                code="yields" if driven or fall.at_limit else "not_held",
                axis=limit.name,
            )

    def _check_given(self, sample: Sample, asked: Sequence[float]) -> None:
        """What is given and done against what is asked for; who fails is not trusted to hold afterwards."""
        try:
            self._shortfall.check(sample, asked, self.led & self.weights.keys())
            self.obedience.check(sample, asked)
            self.unmoved.check(sample, asked)
        except SafetyStop as error:
            i = next(k for k, limit in enumerate(self.limits) if limit.name == error.axis)
            if error.code == "stands":
                self.blind.add(i)
            else:
                kind = Kind.FALLS if error.code == "no_torque" else Kind.DRIVEN
                self.falls = {i: Fall(kind, math.nan, sample.torque[i], at_limit=False)}
            raise

    def _check_travel(self, i: int, limit: AxisLimits, travel: float) -> None:
        if travel <= self._travel[i]:
            return
        self._travel[i] = travel
        if travel > limit.position:
            raise SafetyStop(
                sentence(
                    "axis {axis}: position left its window: {travel:.4g} {unit} from the start, limit "
                    "{limit:g}",
                    axis=limit.name,
                    travel=travel,
                    unit=limit.unit,
                    limit=limit.position,
                ),
                way_out="lower the amplitude or widen the window",
                code="position_window",
                axis=limit.name,
            )
        if i in self.resting and travel > REST_SHARE * limit.position:
            raise SafetyStop(
                sentence(
                    "axis {axis}: moved by {travel:.3g} {unit} though its drive is to hold it at rest",
                    axis=limit.name,
                    travel=travel,
                    unit=limit.unit,
                ),
                way_out="somebody moves it, its load is beyond the drive's torque limit, or a sign "
                "is wrong in the drive",
                code="not_held",
                axis=limit.name,
            )

    @staticmethod
    def _check_announced(limit: AxisLimits, position: float, home: float, most: float) -> None:
        if abs(position - home) > most:
            raise SafetyStop(
                sentence(
                    "axis {axis}: moved by {travel:.3g} {unit} before it is shaken, "
                    "{announced:.3g} was announced",
                    axis=limit.name,
                    travel=abs(position - home),
                    unit=limit.unit,
                    announced=most,
                ),
                way_out="a sign is wrong in the drive, somebody moves it, or it is lighter than stated. "
                "Where it carries a load, 0x6077 may not show what holds it: compare 0x6076 and 0x6075 "
                "with the motor's plate",
                code="position_window",
                axis=limit.name,
            )

    def _check_speed(self, i: int, limit: AxisLimits, time: float, position: float) -> float:
        """Check and return the speed over the last cycles less one count of the encoder; 0 with one
        sample only.
        """
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
                    sentence(
                        "axis {axis}: velocity {speed:.4g} {unit}/s, limit {limit:g}",
                        axis=limit.name,
                        speed=speed,
                        unit=limit.unit,
                        limit=limit.velocity,
                    ),
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
                sentence(
                    "axis {axis}: torque {torque:.4g} {unit}, limit {limit:g}: the drive "
                    "gives more than it was asked for",
                    axis=limit.name,
                    torque=torque,
                    unit=limit.torque_unit,
                    limit=limit.torque,
                ),
                way_out="check rated_torque and the drive's tuning",
                code="torque",
                axis=limit.name,
            )

    def _missing(self, i: int, sample: Sample) -> None:
        self._lost[i] += 1
        self._missed[i] += 1
        if self._missed[i] < self._most_missed:
            return
        name, count = self.limits[i].name, self._missed[i]
        if sample.late and sample.late[i]:
            alone = any(sample.fresh)
            raise DriveError(
                f"axis {name}: its answers come more than a cycle late, for {count} cycles in a row"
                + (", those of others in time" if alone else ", like all others"),
                way_out=f"{'the drive' if alone else 'the adapter or its driver'} takes longer at times: "
                "lengthen bus.cycle_s, or safety.missed_tpdos",
                code="no_answer",
                axis=name,
            )
        raise DriveError(
            sentence("axis {axis}: no position for {count} cycles in a row", axis=name, count=count),
            way_out="check its cable, its supply and the bus",
            code="no_answer",
            axis=name,
        )

    def _events(self, sample: Sample) -> None:
        for event in sample.events:
            if event.severity is Severity.DRIVE:
                raise DriveError(event.text, code="drive_fault", axis=event.axis)
            if event.severity is Severity.BUS:
                raise BusError(event.text, code="bus")


def bounds_of(config: CellConfig, resolution: Sequence[float], rated: Sequence[float]) -> Bounds:
    """The bounds that a config sets; ``resolution`` of the encoders, ``rated`` torques of the axes."""
    unit, torque_unit = ("m", "N") if config.linear else ("rad", "N·m")
    limits = [
        AxisLimits(
            a.name,
            a.limits.torque,
            a.limits.position,
            a.limits.velocity,
            resolution[i],
            rated[i],
            unit,
            torque_unit,
        )
        for i, a in enumerate(config.axes)
    ]
    safety = config.safety
    return Bounds(
        limits,
        cycle_s=config.bus.cycle_s,
        missed_tpdos=safety.missed_tpdos,
        overrun_cycles=safety.overrun_cycles,
    )
