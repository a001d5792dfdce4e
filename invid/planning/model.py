"""A plan: experiments as data, and what they may cause, before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from invid.numerics.arrays import Float64
from invid.planning.budget import BusBudget
from invid.recording.model import Kind, Role


@dataclass(frozen=True, eq=False)
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

    key: str
    kind: Kind
    role: Role
    excited: tuple[int, ...]
    torque: Float64
    reference: Float64 | None
    record_from: int
    record_to: int
    period_samples: int
    frequencies_hz: Float64
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cycles(self) -> int:
        """Length in SYNC cycles, settling and fading included."""
        return int(self.torque.shape[0])

    @property
    def excited_axis(self) -> int:
        """Index of the excited axis; −1 for several."""
        return self.excited[0] if len(self.excited) == 1 else -1


@dataclass(frozen=True)
class AxisForecast:
    """What an axis may see, at full amplitude."""

    axis: str
    unit: str
    peak_torque: float
    travel: float | None
    """Largest expected distance from the start; ``None`` where no inertia is known."""
    velocity: float | None
    power: float | None
    """Peak torque times peak velocity [W]."""
    travel_limit: float
    """The position window: beyond it the motion is stopped, whatever was expected."""
    basis: str
    """``model``, ``inertia`` or ``unknown``."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Experiments in order, and the facts of a dry run."""

    axes: tuple[str, ...]
    cycle_s: float
    experiments: tuple[PlannedExperiment, ...]
    rest_s: float
    budget: BusBudget
    forecast: tuple[AxisForecast, ...]
    warnings: tuple[str, ...] = ()

    @property
    def excited(self) -> tuple[int, ...]:
        """Axes that any experiment excites."""
        return tuple(sorted({i for e in self.experiments for i in e.excited}))

    @property
    def duration_s(self) -> float:
        """Robot time of the experiments and the rests between them, trials of the signs apart [s]."""
        cycles = sum(e.cycles for e in self.experiments)
        return cycles * self.cycle_s + len(self.experiments) * self.rest_s

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
                for e in self.experiments
            ],
            "forecast": [
                {
                    "axis": f.axis,
                    "unit": f.unit,
                    "peak_torque": f.peak_torque,
                    "travel": f.travel,
                    "travel_limit": f.travel_limit,
                    "velocity": f.velocity,
                    "power_W": f.power,
                    "basis": f.basis,
                }
                for f in self.forecast
            ],
            "warnings": list(self.warnings),
        }
