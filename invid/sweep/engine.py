"""Run a plan against ports. Whoever energises also stops, whatever happens in between."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.config import CellConfig
from invid.errors import InvidError
from invid.numerics.arrays import Float64
from invid.planning.forecast import lower_torque
from invid.planning.hold_laws import master_hold
from invid.planning.model import AxisForecast, PhasePlan, Plan, Step
from invid.planning.phases import lowest_frequency
from invid.planning.stopping_distance import Permitted
from invid.recording.model import Kind
from invid.sweep.bounds import Statistics
from invid.sweep.cell import Cell
from invid.sweep.motion import Motion, RowSink
from invid.sweep.ports import Procedure, Sink
from invid.sweep.rehearsal import Rehearsal
from invid.wording.sentence import sentence

WORTH_SAYING = 0.9
"""A permitted speed that the measured inertia lowers by less than a tenth needs no words."""


@dataclass(frozen=True)
class Progress:
    """Progress of a measurement: phase, axis, share that is done."""

    phase: str
    axis: str | None
    frequency: float | None
    """[Hz] where there is one."""
    fraction: float
    """0…1."""
    eta_s: float
    """Remaining robot time [s]."""
    forecast: tuple[AxisForecast, ...] = ()
    """What is announced now: before the trials by the plan, after them by what they measured."""


@dataclass(frozen=True)
class SweepResult:
    """Facts of a finished sweep."""

    scale: float
    """Factor applied to every torque of the plan; below 1 where a limit was near."""
    inertia: dict[str, float]
    """Rigid inertia of each excited axis as the trial saw it [kg·m² or kg]."""
    statistics: Statistics
    forecast: tuple[AxisForecast, ...] = ()
    """What was announced after the trials."""
    warnings: tuple[str, ...] = ()
    measured_s: float = 0.0


@dataclass
class Sweep:
    """One run of one plan. ``run`` may be called once."""

    plan: Plan
    config: CellConfig
    cell: Cell
    sink: Sink
    progress: Callable[[Progress], None] | None = None
    stop: threading.Event | None = None
    warnings: list[str] = field(default_factory=list)
    go_on: Callable[[], bool] | None = None
    """Asked after each experiment but the last whether the next one is needed."""
    permit: Callable[[Sequence[float | None], Sequence[float | None], float], Permitted] | None = None
    """Speeds and torque by the inertia and the hold torque of each axis as the trials of the signs measured
    them, for a share of the torque that is played: less is permitted to an axis that takes longer to stop
    than was stated, and more speed to less torque, which goes on when the master dies."""

    def __post_init__(self) -> None:
        self._motion = Motion(self.plan, self.config, self.cell, self.stop, self._report)
        self._rehearsal = Rehearsal(
            self._motion, self.warnings, self._stated_inertia(), self._permitted_velocity, self.sink
        )
        self._total_s = self.plan.duration_s
        self._torque = np.ones(len(self.plan.axes))
        self._slower: set[int] = set()

    def _stated_inertia(self) -> list[tuple[float, str] | None]:
        """Rigid inertia of each axis [kg·m² or kg] and who says it."""
        key = "mass_kg" if self.config.linear else "inertia_kgm2"
        return [
            None
            if value is None
            else (value, f"{key} of the config" if axis.inertia is not None else "the last model")
            for axis, value in zip(self.config.axes, self.plan.inertia, strict=True)
        ]

    # --- the run -------------------------------------------------------------------------------
    def run(self) -> SweepResult:
        """Enable, try, measure, stop.

        Raises
        ------
        SafetyStop, DriveError, BusError
            The drives are stopped by then; what the sink holds is what was measured so far.
        """
        self._report()
        for axis in self.config.axes:
            master_hold(axis, self.plan.cycle_s)  # refuses an unstable hold before anything is enabled
        try:
            self.cell.run(self._procedure())
        except InvidError as error:
            error.moment = self._motion.moment
            raise
        finally:
            self.cell.stop()
        measured_s = self._motion.done_s
        self._motion.phase, self._motion.done_s = "done", self._total_s
        self._report()
        self.warnings += self._motion.watching.words.said()
        return SweepResult(
            scale=float(self._rehearsal.scales.min(initial=1.0) * self._torque.min()),
            inertia={self.plan.axes[i]: m for i, m in self._motion.inertia.items()},
            statistics=self._motion.watching.bounds.statistics,
            forecast=self._motion.forecast,
            warnings=tuple(self.warnings),
            measured_s=measured_s,
        )

    def _procedure(self) -> Procedure[None]:
        for phase in self.plan.phases:
            match phase.step:
                case Step.SETTLE:
                    yield from self._motion.start()
                    self.warnings += [load.said for load in self._motion.loads if load.said]
                case Step.SIGNS:
                    yield from self._rehearsal.try_signs(phase.number)
                case Step.TRIAL:
                    self._lower_torque()
                    yield from self._rehearsal.try_amplitude(self.plan.trials[phase.number])
                    self._motion.forecast = self._rehearsal.forecast()
                    recorded = self.plan.trials[phase.number].recorded_share > 0
                    if recorded and self._is_enough():
                        self._total_s = self._motion.done_s
                        break
                case Step.EXPERIMENT:
                    self._lower_torque()
                    yield from self._experiment(phase)
                    more = phase.number + 1 < len(self.plan.experiments)
                    if more and self._is_enough():
                        self._total_s = self._motion.done_s
                        break
                case Step.RETURN:
                    self._motion.phase, self._motion.experiment = phase.name, None
                    yield from self._motion.rest(set(self._motion.led))

    @property
    def statistics(self) -> Statistics:
        """What was seen so far."""
        return self._motion.statistics

    def _is_enough(self) -> bool:
        return self.go_on is not None and not self.go_on()

    def _permitted(self, played: float) -> Permitted:
        """Return the speeds and torque permitted by what was measured so far, for a share of the torque
        that is played.
        """
        motion = self._motion
        if self.permit is None:
            return Permitted(self.config, (1.0,) * motion.count)
        loads = [
            b if a.gravity_loaded else None for a, b in zip(motion.config.axes, motion.bias, strict=True)
        ]
        return self.permit([motion.inertia.get(i) for i in range(motion.count)], loads, played)

    def _permitted_velocity(self, played: float) -> Float64:
        """(M,) speed that is permitted while so much of the torque is played, never more than announced."""
        limits = [a.limits.velocity for a in self._permitted(played).config.axes]
        return np.minimum(limits, [a.limits.velocity for a in self.config.axes])

    def _lower_torque(self) -> None:
        """The plan with as much of the torque as the axes, as heavy as they were measured, can come to rest
        with; never more than before."""
        torque = np.minimum(self._torque, self._permitted(1.0).torque)
        unit = "N" if self.config.linear else "N·m"
        for i in np.flatnonzero(torque < WORTH_SAYING * self._torque):
            peak = self.plan.peak_torque[i] * torque[i] / self._torque[i]
            self.warnings.append(
                sentence(
                    "axis {axis}: by the inertia and load that were measured, it is shaken with "
                    "{torque:.0%} of the planned torque, {peak:.3g} {unit}, so that it comes to rest "
                    "in time",
                    axis=self.plan.axes[i],
                    torque=torque[i],
                    peak=peak,
                    unit=unit,
                )
            )
        self.plan = self._motion.plan = lower_torque(self.plan, torque / self._torque)
        self._torque = torque

    def _limit_velocity(self, played: float) -> None:
        """Watch the speeds that are permitted from here on; say which are much lower than announced."""
        unit = "m/s" if self.config.linear else "rad/s"
        for i, now in enumerate(self._permitted_velocity(played).tolist()):
            before = self.config.axes[i].limits.velocity
            self._motion.permit(i, now)
            if now < WORTH_SAYING * before and i not in self._slower:
                self._slower.add(i)
                self.warnings.append(
                    sentence(
                        "axis {axis}: by the inertia and load that were measured, at most {now:.3g} {unit} "
                        "are permitted, not {before:.3g}, so that it comes to rest in time",
                        axis=self.plan.axes[i],
                        now=now,
                        unit=unit,
                        before=before,
                    )
                )

    def _experiment(self, phase: PhasePlan) -> Procedure[None]:
        experiment, scale = self.plan.experiments[phase.number], float(self._rehearsal.scales[phase.number])
        self._motion.phase = phase.name
        self._motion.experiment = experiment
        self._limit_velocity(scale)
        path = experiment.kind is Kind.CONSTANT_VELOCITY
        excited = set(experiment.excited)
        yield from self._motion.rest(excited)
        yield from self._motion.centre(excited, lowest=lowest_frequency([experiment]), path=path)
        self.sink.begin(experiment, self._motion.stated_holds(), scale)
        # a path is followed with what torque that takes; a share that friction may hide moves nobody surely
        played = scale * np.abs(experiment.torque).max(axis=0, initial=0.0)
        moved = set() if path else excited & self._rehearsal.moved_by(played)
        self._motion.watching.expect_motion(moved, lowest_frequency([experiment]))
        try:
            yield from self._motion.play(
                experiment.torque,
                experiment.cycles,
                reference=experiment.reference,
                scale=scale,
                recording=RowSink(self.sink, experiment.record_from, experiment.record_to),
            )
        finally:
            self._motion.watching.expect_motion(())
            self.sink.end()

    def say(self, phase: str) -> None:
        """Report what is being done that no part of the plan is."""
        self._motion.phase, self._motion.experiment = phase, None
        self._report()

    def _report(self, within: float = 0.0) -> None:
        if self.progress is None:
            return
        done = min(self._motion.done_s + within, self._total_s)
        e = self._motion.experiment
        self.progress(
            Progress(
                phase=self._motion.phase,
                axis=self.plan.axes[e.excited[0]] if e is not None and len(e.excited) == 1 else None,
                frequency=float(e.frequencies_hz[0])
                if e is not None and e.frequencies_hz.size == 1
                else None,
                fraction=done / self._total_s if self._total_s > 0 else 1.0,
                eta_s=max(self._total_s - done, 0.0),
                forecast=self._motion.forecast,
            )
        )
