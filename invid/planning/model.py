"""A plan: experiments as data, and what they may cause, before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64, frozen_float
from invid.planning.budget import BusBudget
from invid.recording.model import Kind, Role


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedExperiment:
    """One experiment, cycle by cycle.

    Attributes
    ----------
    torque
        (n, M) excitation [N·m or N] around the hold's torque; axes that are not excited have zeros.
    reference
        (n, M) path that a master PD follows, relative to where the axis stood; ``None``: stand still.
    record_from, record_to
        Rows that go into the recording; what lies before settles, what lies after fades out.
    """

    key: str = ""
    """Its number in the plan, as text."""
    kind: Kind
    role: Role = Role.IDENTIFY
    excited: tuple[int, ...]
    torque: Float64
    reference: Float64 | None = None
    record_from: int = 0
    record_to: int = 0
    period_samples: int = 0
    frequencies_hz: Float64 = field(default_factory=lambda: frozen_float([]))
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cycles(self) -> int:
        """Length in SYNC cycles, settling and fading included."""
        return int(self.torque.shape[0])

    @property
    def excited_axis(self) -> int:
        """Index of the excited axis; −1 for several."""
        return self.excited[0] if len(self.excited) == 1 else -1


class Step(StrEnum):
    """What a phase of a sweep is for."""

    SETTLE = "settle"
    """Held where every axis stands."""
    SIGNS = "signs"
    """Doublets on one axis: do torque and encoder agree in sign?"""
    TRIAL = "trial"
    """The start of an experiment at a tenth, then at a third of its amplitude."""
    EXPERIMENT = "experiment"
    """A rest, then one experiment with its start, run-in, record and end."""
    RETURN = "return"
    """Every axis back to its place and to rest, before the drives are switched off."""


@dataclass(frozen=True)
class PhasePlan:
    """One phase: its step, the number of its axis (signs), trial or experiment, and its length."""

    step: Step
    number: int
    name: str
    cycles: int
    """Expected length in SYNC cycles, rests included; doublets may take more or fewer."""


@dataclass(frozen=True, eq=False)
class Doublet:
    """What a model foretells of the doublet that moves an axis far enough to tell its signs."""

    length_s: float
    inertia: float
    """The rigid one that would move as far [kg·m² or kg]."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Trial at a small amplitude for the experiments that it stands for.

    Attributes
    ----------
    covers
        Numbers of those experiments.
    spread
        (3, M) how much further, faster and stronger they may be than the trial's own start at the same
        amplitude.
    """

    experiment: PlannedExperiment
    covers: tuple[int, ...]
    spread: Float64
    usual: Float64
    """(3, M) the same for nearly all cells: by this the torque is lowered."""
    recorded_share: float = 0.0
    """Share of its amplitude at which its second step, the climb, is expected to be recorded as an
    experiment of its own; 0: it is not recorded."""
    is_foretold: bool = False
    """Whether a model says what it does: the first step is left out where doublets moved every axis so."""


@dataclass(frozen=True)
class AxisForecast:
    """What an axis may at most see from the first cycle to the last, trials and moves included."""

    axis: str
    unit: str
    peak_torque: float
    """Excitation, hold and, on a held axis, the reaction to the others; with the noise of its reading."""
    travel: float
    """Distance from where it stood at the start [rad or m]."""
    velocity: float
    power: float
    """Peak torque times peak velocity [W]."""
    travel_limit: float
    """The position window: beyond it the motion is stopped, whatever was expected."""
    basis: str
    """``model``: foretold from the last model; ``limits``: nobody knows the plant, and the sweep keeps below
    these; ``trial``: measured at a small amplitude."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "axis": self.axis,
            "unit": self.unit,
            "peak_torque": self.peak_torque,
            "travel": self.travel,
            "travel_limit": self.travel_limit,
            "velocity": self.velocity,
            "power_W": self.power,
            "basis": self.basis,
        }


@dataclass(frozen=True, eq=False)
class Plan:
    """Experiments in order, the phases around them, and the facts of a dry run."""

    axes: tuple[str, ...]
    cycle_s: float
    experiments: tuple[PlannedExperiment, ...]
    rest_s: float
    budget: BusBudget
    forecast: tuple[AxisForecast, ...]
    doublets: tuple[Doublet | None, ...]
    """By the model, for each axis that is shaken."""
    warnings: tuple[str, ...] = ()
    trials: tuple[Trial, ...] = ()
    phases: tuple[PhasePlan, ...] = ()
    share: float = 1.0
    """Of the torque that could be planned."""
    inertia: tuple[float | None, ...] = ()
    """Rigid inertia of each axis by the config, else by the model; ``None``: the sign trial must tell."""

    @property
    def excited(self) -> tuple[int, ...]:
        """Axes that any experiment excites."""
        return tuple(sorted({i for e in self.experiments for i in e.excited}))

    @property
    def recorded(self) -> tuple[PlannedExperiment, ...]:
        """What comes into the recording, in order: climbs at their expected torque, then the experiments."""
        climbs = [
            replace(t.experiment, torque=frozen_float(t.recorded_share * t.experiment.torque))
            for t in self.trials
            if t.recorded_share
        ]
        return (*climbs, *self.experiments)

    @property
    def peak_torque(self) -> Float64:
        """(M,) largest excitation of each axis [N·m or N]."""
        played = (*self.experiments, *(t.experiment for t in self.trials if t.recorded_share))
        peaks = [np.abs(e.torque).max(axis=0, initial=0.0) for e in played]
        largest: Float64 = np.max([np.zeros(len(self.axes)), *peaks], axis=0)
        return largest

    @property
    def duration_s(self) -> float:
        """Robot time of the whole run: settling, trials, experiments and the rests between them [s]."""
        return sum(p.cycles for p in self.phases) * self.cycle_s

    @property
    def shaking_s(self) -> float:
        """Robot time of what is recorded and the rests after it [s]."""
        cycles = sum(e.cycles for e in self.recorded)
        return cycles * self.cycle_s + len(self.recorded) * self.rest_s

    def first(self, count: int) -> Plan:
        """The plan with its first ``count`` experiments only."""
        kept = tuple(p for p in self.phases if p.step is not Step.EXPERIMENT or p.number < count)
        trials = tuple(replace(t, covers=tuple(k for k in t.covers if k < count)) for t in self.trials)
        return replace(self, experiments=self.experiments[:count], phases=kept, trials=trials)

    def to_json(self) -> dict[str, Any]:
        """Facts for a person or a page, in plain values."""
        return {
            "axes": list(self.axes),
            "excited": [self.axes[i] for i in self.excited],
            "duration_s": self.duration_s,
            "cycle_s": self.cycle_s,
            "bus_load": self.budget.load,
            "bus_max_load": self.budget.max_load,
            "experiments": [
                {
                    "key": e.key,
                    "kind": str(e.kind),
                    "role": str(e.role),
                    "axes": [self.axes[i] for i in e.excited],
                    "duration_s": e.cycles * self.cycle_s,
                    "recorded_s": (e.record_to - e.record_from) * self.cycle_s,
                    "lines": int(e.frequencies_hz.size),
                    "lowest_Hz": float(e.frequencies_hz.min()) if e.frequencies_hz.size else None,
                    "highest_Hz": float(e.frequencies_hz.max()) if e.frequencies_hz.size else None,
                }
                for e in self.recorded
            ],
            "forecast": [f.to_json() for f in self.forecast],
            "warnings": list(self.warnings),
        }
