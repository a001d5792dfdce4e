"""A recording as a cell: gives back what was measured, sample by sample, whatever is demanded.

For rehearsing limits and the way out on data of the real machine, with nothing behind it.
"""

from __future__ import annotations

from collections.abc import Sequence

from invid.errors import BusError, InputError
from invid.recording import Experiment, Recording
from invid.sweep.ports import Clock, Mode, Sample


class ReplayClock:
    """Time of the recording: it passes when somebody waits for it."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Seconds since the start of the replay."""
        return self._now

    def sleep_until(self, instant: float) -> None:
        """Let it pass."""
        self._now = max(self._now, instant)


class ReplayCell:
    """Implements ``invid.sweep.ports.Cell`` on one experiment of a recording.

    Raises
    ------
    InputError
        The recording has no such experiment.
    BusError
        From ``exchange``, once every sample was given.
    """

    def __init__(self, recording: Recording, key: str | None = None) -> None:
        found = [e for e in recording.experiments if key is None or e.key == key]
        if not found:
            raise InputError(f"{recording.source}: no experiment {key!r} to replay")
        self._recording, self._experiment = recording, found[0]
        self._clock = ReplayClock()
        self._row = 0
        self.energised = False

    @property
    def experiment(self) -> Experiment:
        """What is replayed."""
        return self._experiment

    @property
    def axes(self) -> tuple[str, ...]:
        """Names, in the order of every list."""
        return self._recording.axes

    @property
    def clock(self) -> Clock:
        """The recording's time."""
        return self._clock

    @property
    def can_hold(self) -> tuple[bool, ...]:
        """Nothing moves, so everything holds."""
        return (True,) * len(self.axes)

    @property
    def resolution(self) -> tuple[float, ...]:
        """Position of one encoder count of each axis [rad or m]; 0 where the recording does not say."""
        known = self._recording.encoder_resolution
        return tuple(float(r) for r in known) if known is not None else (0.0,) * len(self.axes)

    @property
    def rated_torque(self) -> tuple[float, ...]:
        """Rated torque, or where the recording does not say, the largest torque in it [N·m or N]."""
        known = self._recording.rated_torque
        if known is not None:
            return tuple(float(r) for r in known)
        return tuple(float(t) for t in abs(self._experiment.torque).max(axis=0))

    def energise(self, modes: Sequence[Mode]) -> None:
        """Begin at the first sample."""
        self._row = 0
        self.energised = True

    def secure(self, loaded: Sequence[bool]) -> bool:
        """Nothing falls."""
        return False

    def set_modes(self, modes: Sequence[Mode]) -> None:
        """What was held is in the recording."""

    @property
    def changing(self) -> bool:
        """Never."""
        return False

    def exchange(self, torque: Sequence[float]) -> Sample:
        """The next sample; BusError after the last."""
        e = self._experiment
        if not self.energised:
            raise BusError("replay: exchange before energise")
        if self._row >= e.samples:
            raise BusError(f"replay: experiment {e.key} has ended after {e.samples} samples")
        row = self._row
        self._row += 1
        instant = float(e.time[row] - e.time[0])
        self._clock.sleep_until(instant)
        count = len(self.axes)
        status = [int(s) for s in e.status[row]] if e.status is not None else [0x0027] * count
        return Sample(
            slot=row,
            time=instant,
            position=[float(x) for x in e.position[row]],
            torque=[float(t) for t in e.torque[row]],
            status=status,
            fresh=[True] * count,
            events=[],
        )

    def stop(self) -> None:
        """Nothing moves; safe at any time."""
        self.energised = False
