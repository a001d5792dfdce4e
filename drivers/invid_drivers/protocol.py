"""How the command line and the service talk with processes that work for them: line, launcher, messages.

A measurement, its cycle, an analysis and a tuning each have a process of their own, started by ``launch``.
Both ends hold one socket; a message is one of the frozen types below, and the first is the task. Where the
socket ends, the other side has gone: a process that works then ends in order by itself, and of the axes of a
lost process no more is known than the ``AxisStates`` that it told last.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import IO, Any, Self

from invid.planning.model import PlannedExperiment
from invid.recording import Recording
from invid.wording.sentence import sentence
from invid_drivers.stop_flag import StopFlag

SECOND_LOOK_S = 0.1
"""Within the silence that counts as gone: where the whole computer stood still, the other side gets this long
to speak again."""


# --- to a process that works -----------------------------------------------------------------------
@dataclass(frozen=True)
class Stop:
    """End in order."""


@dataclass(frozen=True)
class Alive:
    """Whoever asked is there."""


@dataclass(frozen=True)
class Judgement:
    """Answer to ``Ask``."""

    needs_more: bool


# --- from the cycle --------------------------------------------------------------------------------
@dataclass(frozen=True)
class LastSeen:
    """What an axis was last seen to be, and when [s since 1970]; ``None``: it was not seen under power."""

    axis: str
    state: str | None = None
    at: float | None = None

    @property
    def sentence(self) -> str:
        """In words."""
        if self.state is None:
            return sentence("axis {axis} was not seen under power", axis=self.axis)
        when = time.strftime("%H:%M:%S", time.localtime(self.at))
        return sentence(
            "axis {axis} was last seen {state}, at {time}", axis=self.axis, state=self.state, time=when
        )


@dataclass(frozen=True)
class AxisStates:
    """The state of every axis; told whenever one changes."""

    axes: tuple[LastSeen, ...] = ()

    def of(self, names: Sequence[str]) -> tuple[LastSeen, ...]:
        """Each of these axes, seen or not: for whoever lost the process that knew them."""
        seen = {a.axis: a for a in self.axes}
        return tuple(seen.get(name, LastSeen(name)) for name in names)


@dataclass(frozen=True)
class Open:
    """The recording begins."""

    header: Recording
    cycle_s: float


@dataclass(frozen=True)
class Begin:
    """An experiment begins."""

    experiment: PlannedExperiment
    hold_gain: Sequence[float]
    scale: float


@dataclass(frozen=True)
class Rows:
    """Cycles of an experiment, packed (``filing.row_format``)."""

    packed: bytes


@dataclass(frozen=True)
class Finish:
    """The experiment is over."""


@dataclass(frozen=True)
class Ask:
    """Whether the recording so far needs another experiment."""


# --- from any --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Done:
    """The last word: what came of it."""

    result: Any = field(default_factory=dict)


@dataclass(frozen=True)
class Failed:
    """The last word: the error that ended it."""

    error: BaseException


class Line:
    """The end of a process that works. Telling never waits for whoever reads.

    ``silence_s``: whoever asked counts as gone where nothing comes for so long [s]; ``None``: only where the
    socket ends.
    """

    def __init__(self, connection: Connection, *, silence_s: float | None = None) -> None:
        self._connection, self._silence_s = connection, silence_s
        self.stop = StopFlag()
        self.orphaned = threading.Event()
        """Whoever asked has gone."""
        self.silent = threading.Event()
        """He is there, but did not speak in time."""
        self._outbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()

    @classmethod
    def of_process(cls, *, silence_s: float | None = None) -> Self:
        """The line of this process, which ``launch`` started."""
        return cls(Connection(int(sys.argv[1])), silence_s=silence_s)

    @property
    def waiting(self) -> int:
        """How many messages nobody has taken yet."""
        return self._outbox.qsize()

    def read_task(self) -> Any:
        """The first message."""
        return self._connection.recv()

    def listen(self, heard: Callable[[Any], None] = lambda message: None) -> None:
        """Start to listen; what is neither ``Stop`` nor ``Alive`` goes to ``heard``."""
        threading.Thread(target=self._listen, args=(heard,), name="listener", daemon=True).start()

    def _listen(self, heard: Callable[[Any], None]) -> None:
        try:
            while self._is_spoken_to():
                match message := self._connection.recv():
                    case Stop():
                        self.stop.set()
                    case Alive():
                        pass
                    case _:
                        heard(message)
            self.silent.set()
        except (EOFError, OSError):
            self.orphaned.set()
        finally:
            self.stop.set()  # whatever ended this thread: nobody could stop the axes any more

    def _is_spoken_to(self) -> bool:
        if self._silence_s is None or self.stop.is_set():
            return self._connection.poll(None)
        return self._connection.poll(self._silence_s - SECOND_LOOK_S) or self._connection.poll(SECOND_LOOK_S)

    def _write(self) -> None:
        with contextlib.suppress(OSError):  # he has gone; whatever moves is stopped all the same
            while (message := self._outbox.get()) is not None:
                self._connection.send(message)

    def tell(self, message: Any) -> None:
        """Queue a message."""
        self._outbox.put(message)

    def close(self, longest_s: float | None = None) -> None:
        """Send what is queued, however long that takes unless a time is given [s]."""
        self._outbox.put(None)
        self._writer.join(longest_s)


@dataclass(frozen=True)
class Process:
    """A process that works, seen by whoever started it."""

    connection: Connection
    child: subprocess.Popen[bytes]

    def send(self, message: Any) -> None:
        """Tell it something; nothing happens where it has gone."""
        with contextlib.suppress(OSError):
            self.connection.send(message)


def launch(
    module: str,
    task: Any,
    *,
    log: IO[bytes] | None = None,
    environment: Mapping[str, str] | None = None,
    own_session: bool = False,
) -> Process:
    """Start ``python -m module`` and hand it its task.

    ``log`` takes what it prints; without it stdout goes nowhere and stderr is this process's.
    ``own_session``: what a terminal sends to this process does not reach it.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        child = subprocess.Popen(
            [sys.executable, "-m", module, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL if log is None else log,
            stderr=log,
            env=None if environment is None else dict(environment),
            start_new_session=own_session,
        )
    process = Process(Connection(ours.detach()), child)
    process.send(task)
    return process
