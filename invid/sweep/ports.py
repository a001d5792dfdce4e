"""Interfaces that the sweep engine needs: a clock, a place for the samples; what drives are told and say."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto
from typing import Protocol, TypeVar

from invid.planning.model import PlannedExperiment


class Mode(StrEnum):
    """What a drive does with an energised axis."""

    TORQUE = "torque"
    """Follows the master's torque every cycle (cyclic synchronous torque)."""
    HOLD = "hold"
    """Holds its place by itself (cyclic synchronous position); survives the loss of the master."""


class Want(Enum):
    """What a procedure wishes of an axis."""

    STAY = auto()
    HOLD = auto()
    """Held by its drive."""
    LEAD = auto()
    """In torque mode."""
    PARK = auto()
    """Quick stop."""
    BRAKE = auto()
    END = auto()
    """To rest, to what holds it, and off where nothing needs to."""


@dataclass(frozen=True)
class Wish:
    """What is wished of every axis in the coming cycle; torque of those that are led, empty: as before."""

    wants: Sequence[Want]
    torque: Sequence[float] = ()


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


T = TypeVar("T")
Procedure = Generator[Wish, Sample, T]
"""Yields a wish once a cycle and sees the sample that answers it."""


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


class Sink(Protocol):
    """Receiver of the samples of a sweep."""

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        """Begin a new experiment."""

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        """Take one cycle of the experiment. The sample's lists are only valid during the call."""

    def end(self) -> None:
        """End the experiment."""
