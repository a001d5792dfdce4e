"""The sweep: runs a plan against ports. Whoever energises also stops, whatever happens in between."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from invid.chains import CoupledChains
from invid.config import CellConfig
from invid.plan.model import Plan, PlannedExperiment
from invid.recording.model import Kind
from invid.sweep.holds import master_hold
from invid.sweep.motion import Motion
from invid.sweep.ports import Cell, Sink
from invid.sweep.rehearsal import CLIMB_S, TRIAL_PERIOD_S, Rehearsal, lowest_frequency
from invid.sweep.watch import Statistics

TRIAL_SIGNS_S = 3.5
"""What the trial of the signs of one axis takes about (case study)."""
DECIDE_S, DECIDE_POLL_S = 60.0, 0.1
"""The axes are held this long while whoever ordered the measurement judges what is there."""


@dataclass(frozen=True)
class Progress:
    """Where a measurement is."""

    phase: str
    axis: str | None
    frequency: float | None
    """[Hz] where there is one."""
    fraction: float
    """0…1."""
    eta_s: float
    """Remaining robot time [s]."""


@dataclass(frozen=True)
class SweepResult:
    """Facts of a finished sweep."""

    scale: float
    """Factor applied to every torque of the plan; below 1 where a limit was near."""
    inertia: dict[str, float]
    """Rigid inertia of each excited axis as the trial saw it [kg·m² or kg]."""
    statistics: Statistics
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
    go_on: Callable[[int], bool | None] | None = None
    """Asked after each experiment but the last, with its number: True next one, False enough, ``None`` not
    known yet (the axes are held, and it is asked again)."""
    model: CoupledChains | None = None
    """The last accepted model: what an axis is expected to weigh where the config does not say."""

    def __post_init__(self) -> None:
        self._motion = Motion(self.plan, self.config, self.cell, self.stop, self._report)
        self._rehearsal = Rehearsal(self._motion, self.warnings, self._stated_inertia())
        self._total_s = self.plan.duration_s + self._trial_s()

    def _stated_inertia(self) -> list[tuple[float, str] | None]:
        """Rigid inertia of each axis [kg·m² or kg] and who says it."""
        key = "mass_kg" if self.config.linear else "inertia_kgm2"
        stated: list[tuple[float, str] | None] = []
        for i, axis in enumerate(self.config.axes):
            if axis.inertia is not None:
                stated.append((axis.inertia, f"{key} of the config"))
            elif self.model is not None:
                stated.append((float(self.model.masses[i].sum()), "the last model"))
            else:
                stated.append(None)
        return stated

    def _trial_s(self) -> float:
        return TRIAL_SIGNS_S * len(self.plan.excited) + TRIAL_PERIOD_S + CLIMB_S + self.plan.rest_s

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
            self._motion.start()
            for i in self.plan.excited:
                self._rehearsal.try_signs(i)
            self._rehearsal.try_amplitude()
            for number, experiment in enumerate(self.plan.experiments):
                self._experiment(experiment, number)
                if number + 1 < len(self.plan.experiments) and self._enough(number):
                    self._total_s = self._motion.done_s
                    break
        finally:
            self.cell.stop()
        self._motion.phase, self._motion.done_s = "done", self._total_s
        self._report()
        return SweepResult(
            scale=self._rehearsal.scale,
            inertia={self.plan.axes[i]: m for i, m in self._motion.inertia.items()},
            statistics=self._motion.watching.statistics,
            warnings=tuple(self.warnings),
            measured_s=self._total_s,
        )

    @property
    def statistics(self) -> Statistics:
        """What was seen so far."""
        return self._motion.statistics

    def _enough(self, number: int) -> bool:
        """Whether the measurement may end after this experiment; holds every axis until that is known."""
        if self.go_on is None:
            return False
        self._motion.phase, self._motion.experiment = "judging what was measured", None
        for _ in range(round(DECIDE_S / DECIDE_POLL_S)):
            answer = self.go_on(number)
            if answer is not None:
                return not answer
            self._motion.play(None, max(1, round(DECIDE_POLL_S / self.plan.cycle_s)))
        self.warnings.append(
            f"nobody said within {DECIDE_S:g} s whether to go on after experiment {number + 1}: ended there"
        )
        return True

    def _experiment(self, experiment: PlannedExperiment, number: int) -> None:
        self._motion.phase = f"experiment {number + 1} of {len(self.plan.experiments)}"
        self._motion.experiment = experiment
        path = experiment.kind is Kind.CONSTANT_VELOCITY
        excited = set(experiment.excited)
        self._motion.centre(excited, lowest=lowest_frequency([experiment]), path=path)
        cycle = self.plan.cycle_s
        self._motion.play(None, round(self.plan.rest_s / cycle))
        gains = [float("nan")] * self._motion.count
        for f in self._motion.feedback:
            gains[f.axis] = f.gains.stiffness
        self.sink.begin(experiment, gains, self._rehearsal.scale)
        self._motion.must_move = set() if path else excited
        self._motion.watching.standing.slowest(lowest_frequency([experiment]))
        try:
            self._motion.play(
                experiment.torque,
                experiment.cycles,
                reference=experiment.reference,
                scale=self._rehearsal.scale,
                sink=self.sink,
                rows=(experiment.record_from, experiment.record_to),
            )
        finally:
            self._motion.must_move = set()
            self._motion.watching.excited = set()
            self._motion.expect_life(False)
            self.sink.end()

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
            )
        )
