"""Interface of a cell of drives to the sweep engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from invid.sweep.bounds import Bounds
from invid.sweep.ports import Clock, Loop, Mode, Procedure, T


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
        """What no cycle may pass, judged in every cycle; ``None`` before the drives were asked."""

    @property
    def resolution(self) -> tuple[float, ...]:
        """Position of one encoder count of each axis [rad or m]."""

    @property
    def rated_torque(self) -> tuple[float, ...]:
        """Rated torque of each axis [N·m or N]."""

    def run(self, procedure: Procedure[T]) -> T:
        """What a procedure returns, with a cycle for each of its wishes. SafetyStop, DriveError or BusError
        where the motion must stop."""

    def energise(self, modes: Sequence[Mode]) -> Procedure[None]:
        """Enable every axis in its mode, at rest where it stands."""

    def secure(self, loaded: Sequence[bool]) -> Procedure[bool]:
        """Take over which axes carry a load, and see, at rest, that each of those stays held after a stop.

        Whether axes were let go or stopped for it: they are held again, perhaps in another place. SafetyStop
        where an axis would fall; what holds it then is the cell's to say.
        """

    def set_loops(self, loops: Sequence[Loop | None]) -> None:
        """Loops by which led axes are brought to rest when the run ends."""

    @property
    def changing(self) -> bool:
        """Return whether an axis has not taken the mode that was wished for; until then it is wished on, with
        torque for it, whichever mode it is in.
        """

    def stop(self) -> None:
        """Quick stop, disable voltage, NMT stop. From any state, any number of times; never raises."""
