"""``Recording`` and ``Experiment``: measured data in memory, in the contract's terms.

Reading and writing HDF5 is in ``invid.recording.hdf5``; this module is data only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from invid.numerics.arrays import Bool, Float64, UInt16

DATASETS = ("position", "torque", "torque_demand", "status", "position_reference", "torque_feedforward")
"""Datasets of n rows and M columns; the last two are this program's own additions."""


class Kind(StrEnum):
    """What moved the axes."""

    MULTISINE = "multisine"
    STEPPED_SINE = "stepped_sine"
    CHIRP = "chirp"
    CONSTANT_VELOCITY = "constant_velocity"
    OTHER = "other"


class Role(StrEnum):
    """What the data may be used for; validation data never enters a fit."""

    IDENTIFY = "identify"
    VALIDATE = "validate"


class Outcome(StrEnum):
    """How the measurement ended."""

    COMPLETED = "completed"
    ABORTED = "aborted"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Experiment:
    """One experiment: n samples of M axes.

    Attributes
    ----------
    time
        (n,) SYNC instants [s], strictly increasing.
    position, torque
        (n, M) motor encoder [rad or m] and motor torque 0x6077, scaled [N·m or N].
    torque_demand
        (n, M) 0x6071, scaled, constant over each sample; ``None`` where it was not logged.
    status
        (n, M) statusword 0x6041; ``None`` where it was not logged.
    excited_axis
        Index of the excited axis; −1 for none or several.
    hold_gain
        (M,) torque per position; 0 free, NaN held inside the drive.
    period_samples
        Samples of one period; 0 when not periodic.
    frequencies_hz
        The excited lines [Hz]; empty where unknown.
    attributes
        Other HDF5 attributes, kept as they were.
    position_reference, torque_feedforward
        (n, M) what a known controller was told (extra datasets beside the contract's); ``None`` where
        not known. With the attribute ``controller`` they let closed-loop data be simulated.
    """

    key: str
    kind: Kind
    role: Role
    excited_axis: int
    hold_gain: Float64
    period_samples: int
    frequencies_hz: Float64
    sample_rate_hz: float
    time: Float64
    position: Float64
    torque: Float64
    torque_demand: Float64 | None = None
    status: UInt16 | None = None
    attributes: dict[str, Any] = field(default_factory=dict)
    position_reference: Float64 | None = None
    torque_feedforward: Float64 | None = None

    @property
    def samples(self) -> int:
        """n, the number of samples."""
        return int(self.time.size)

    @property
    def duration(self) -> float:
        """Length of the record [s], n / sample rate."""
        return self.samples / self.sample_rate_hz

    @property
    def is_integrated_velocity(self) -> bool:
        """Whether the record has no position but the running sum of a velocity."""
        return bool(self.attributes.get("position_source") == "integrated_velocity")

    @property
    def periods(self) -> int:
        """Whole periods in the record; 0 when not periodic."""
        return self.samples // self.period_samples if self.period_samples else 0

    def datasets(self) -> dict[str, Any]:
        """The arrays that are given, by name: ``time`` (n,), then those of n rows and M columns."""
        return {name: v for name in ("time", *DATASETS) if (v := getattr(self, name)) is not None}

    def cut(self, rows: slice | Bool) -> Experiment:
        """The experiment on some of its samples."""
        return replace(self, **{name: values[rows] for name, values in self.datasets().items()})


@dataclass(frozen=True, eq=False)
class Recording:
    """All experiments of one measurement of M axes."""

    robot: str
    axes: tuple[str, ...]
    position_unit: str
    torque_unit: str
    created: str
    experiments: tuple[Experiment, ...]
    masses_per_axis: tuple[int, ...] | None = None
    rated_torque: Float64 | None = None
    encoder_resolution: Float64 | None = None
    config: str | None = None
    outcome: Outcome | None = None
    attributes: dict[str, Any] = field(default_factory=dict)
    source: str = "recording"

    @property
    def axis_count(self) -> int:
        """M."""
        return len(self.axes)

    @property
    def linear(self) -> bool:
        """True for axes in metres and newtons."""
        return self.position_unit == "m"

    def with_role(self, role: Role) -> tuple[Experiment, ...]:
        """Experiments of one role, in the order run."""
        return tuple(e for e in self.experiments if e.role is role)


def nominal_sample_rate(time: Float64) -> float:
    """Median sample rate of uneven instants [Hz]."""
    return float(1.0 / np.median(np.diff(time)))
