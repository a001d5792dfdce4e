"""What the stop test and the way out are given of a cell whose drives are energised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import CellConfig
from invid.sweep.falling import Falling
from invid.sweep.ports import Mode, Sample
from invid_drivers.cia402 import states
from invid_drivers.cia402.axis import Drive
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.link import Link
from invid_drivers.cia402.standing.standstill import Standstill, tolerances
from invid_drivers.cia402.states import DriveState, OperationMode, state_of

STOPPING = "stopping"
UNSEEN = "support the load of {}: it is not seen to stand"
"""Phases that are told."""


@dataclass(frozen=True, eq=False)
class MovingCell:
    """The drives of a cell, the bus they are on, and the cycle that commands them.

    ``exchange`` is one cycle of the cell: torque (M,) out, sample in. ``resolution`` (M,) is the position of
    one encoder count [rad or m], ``rated`` (M,) torque [N·m or N]; ``torque_modes`` are those in which they
    are shaken.
    """

    config: CellConfig
    link: Link
    drives: Sequence[Drive]
    cycle: Cycle
    exchange: Callable[[Sequence[float]], Sample]
    resolution: Sequence[float]
    rated: Sequence[float]
    torque_modes: Sequence[OperationMode]
    tell: Callable[[str], None] = lambda phase: None
    """Hears at once what is being done, while it goes on."""

    def standstill(self) -> Standstill:
        """A look at whether axes stand, from now on."""
        return Standstill(tolerances(self.config, self.resolution))

    def falling(self) -> Falling:
        """A look at whether axes fall or are driven away, from now on."""
        limits = [a.limits for a in self.config.axes]
        return Falling(
            self.resolution,
            self.config.bus.cycle_s,
            [a.position for a in limits],
            self.rated,
            [a.torque for a in limits],
        )

    def begin_to_hold(self, axis: int) -> None:
        """Ask a drive for position mode where the axis is by then; until it is seen, its load's torque is
        sent."""
        self.cycle.change(axis, Mode.HOLD, OperationMode.CYCLIC_POSITION)

    def step_to_enabled(self, axis: int, sample: Sample) -> bool:
        """One controlword towards operation enabled, by transition 16 too; whether the axis is there."""
        state = state_of(sample.status[axis])
        if sample.fresh[axis]:
            resumes = state is DriveState.QUICK_STOP_ACTIVE
            self.cycle.control[axis] = states.ENABLE_OPERATION if resumes else states.towards_enabled(state)
        return sample.fresh[axis] and state is DriveState.OPERATION_ENABLED
