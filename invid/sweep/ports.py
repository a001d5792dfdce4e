"""Interfaces that the sweep engine needs: a clock, a cell of drives, a place for the samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from invid.planning.model import PlannedExperiment

if TYPE_CHECKING:
    from invid.sweep.bounds import Bounds


class Mode(StrEnum):
    """What a drive does with an energised axis."""

    TORQUE = "torque"
    """Follows the master's torque every cycle (cyclic synchronous torque)."""
    HOLD = "hold"
    """Holds its place by itself (cyclic synchronous position); survives the loss of the master."""


class Severity(StrEnum):
    """What an event from the bus means for the motion."""

    DRIVE = "drive"
    """A drive failed; everything stops."""
    BUS = "bus"
    """The bus failed; everything stops."""
    NOTE = "note"
    """Worth a line in the result."""


@dataclass(frozen=True)
class Event:
    """Something a drive or the bus said outside the cycle (EMCY, lost heartbeat, late frames, …)."""

    severity: Severity
    text: str
    axis: str | None = None


@dataclass(slots=True)
class Sample:
    """What one SYNC brought; lists are indexed by axis and owned by the cell until the next exchange."""

    slot: int = 0
    """Number of the SYNC slot since the start; a jump of more than one is skipped slots."""
    time: float = 0.0
    """SYNC instant [s]."""
    position: list[float] = field(default_factory=list)
    torque: list[float] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    fresh: list[bool] = field(default_factory=list)
    """False where the axis's TPDO did not come; its values are then the last ones."""
    events: list[Event] = field(default_factory=list)
    listened: int = 0
    """Slots before this one that passed without SYNC on purpose: nobody was late."""
    late: list[bool] = field(default_factory=list)
    """True where answers of earlier SYNCs came since the last fresh one: late, not lost."""


@dataclass(frozen=True)
class Loop:
    """The loop by which a led axis is brought to rest: torque − damping·v."""

    torque: float
    damping: float


class Clock(Protocol):
    """Real or virtual time [s]."""

    def now(self) -> float:
        """Seconds since some fixed instant."""

    def sleep_until(self, instant: float) -> None:
        """Return not before ``instant``."""


class Cell(Protocol):
    """Drives on a bus, all of them held or driven at all times between ``energise`` and ``stop``."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes, in the order of every list."""

    @property
    def clock(self) -> Clock:
        """The clock that the SYNC instants are of."""

    @property
    def can_hold(self) -> tuple[bool, ...]:
        """Return whether each drive can hold its place by itself."""

    @property
    def by_offset(self) -> tuple[bool, ...]:
        """Whether each axis is shaken by its torque offset while its drive goes on holding it."""

    @property
    def bounds(self) -> Bounds | None:
        """What no cycle may pass, judged in every ``exchange``; ``None`` before the drives were asked."""

    @property
    def resolution(self) -> tuple[float, ...]:
        """Position of one encoder count of each axis [rad or m]."""

    @property
    def rated_torque(self) -> tuple[float, ...]:
        """Rated torque of each axis [N·m or N]."""

    def energise(self, modes: Sequence[Mode]) -> None:
        """Enable every axis in its mode, at rest where it stands."""

    def secure(self, loaded: Sequence[bool]) -> bool:
        """Take over which axes carry a load, and see, at rest, that each of those stays held after a stop.

        Whether axes were let go or stopped for it: they are held again, perhaps in another place. SafetyStop
        where an axis would fall; what holds it then is the cell's to say.
        """

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """Ask for other modes while energised; they may come about in later cycles (``changing``)."""

    def set_loops(self, loops: Sequence[Loop | None]) -> None:
        """Loops by which led axes are brought to rest when the run ends."""

    @property
    def changing(self) -> bool:
        """Return whether an axis has not taken the mode that was asked for; ``exchange`` must go on,
        with torque for it, whichever mode it is in.
        """

    def exchange(self, torque: Sequence[float]) -> Sample:
        """Make one cycle: targets out, SYNC at its slot, samples in. SafetyStop, DriveError or BusError where
        the motion must stop."""

    def stop(self) -> None:
        """Quick stop, disable voltage, NMT stop. From any state, any number of times; never raises."""


class Sink(Protocol):
    """Receiver of the samples of a sweep."""

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        """Begin a new experiment."""

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        """Take one cycle of the experiment. The sample's lists are only valid during the call."""

    def end(self) -> None:
        """End the experiment."""
