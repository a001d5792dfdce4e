"""How the command line and the service talk with processes that work for them: messages, line, launcher.

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
from typing import IO, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from invid.planning.model import PlannedExperiment
from invid.recording import Recording
from invid.wording.fields import Text
from invid.wording.sentence import sentence
from invid_drivers.stop_flag import StopFlag

PROGRESS_PERIOD_S, MOST_WAITING = 0.2, 200
"""Progress is told so often at most, and not while so many messages wait for whoever reads them."""
SECOND_LOOK_S = 0.1
"""Within the silence that counts as gone: where the whole computer stood still, the other side gets this long
to speak again."""


# --- to a process that works -----------------------------------------------------------------------
@dataclass(frozen=True)
class Stop:
    """End in order."""


@dataclass(frozen=True)
class Arm:
    """Move."""


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


# --- from a run ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Planned:
    """What will move; without ``arm`` the runner waits for a person."""

    plan: dict[str, Any]
    arm: bool = False


@dataclass(frozen=True)
class Running:
    """The drives are about to be enabled."""


class Known(BaseModel):
    """What the runs of a measurement that still moves tell so far."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    relative_std: float = Field(ge=0)
    """Of the mass, spring or coupling that is known worst."""
    shown: int = Field(ge=0)
    """Causes that would show at their size of interest."""
    asked: int = Field(ge=0)
    """Causes that are of interest."""


class FoundCause(BaseModel):
    """A cause found while the analysis still looks."""

    cause: str
    axis: str
    other_axis: str | None
    element: str | None


class RunProgress(BaseModel):
    """How far a run is."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)
    progress: float = Field(default=0.0, ge=0, le=1)
    phase: Text = ""
    axis: str | None = None
    frequency: float | None = None
    """[Hz]"""
    eta_s: float | None = None
    """Until the result, as the last runs took, in the analysis of a first one as its own stages took [s];
    ``null`` where that is not known: it is the first and moves yet, or it takes longer than they did."""
    most_s: float | None = None
    """Until the analysis ends at the latest, with its best answer so far [s]."""
    motion_left_s: float | None = None
    """Until the axes are at rest, by the plan; ``null`` where nothing moves [s]."""
    cause: str | None = None
    """What the analysis weighs now; its axis is ``axis``."""
    found: list[FoundCause] = []
    """What the analysis found so far; it still looks."""
    known: Known | None = None
    """What the runs so far tell, while the next one moves: the measurement ends when that is enough."""

    @property
    def place(self) -> tuple[float, str, str | None]:
        """Where it is: a run that goes on comes to another one."""
        return self.progress, self.phase, self.axis


@dataclass(frozen=True)
class Measured:
    """The axes are at rest, and what was seen meanwhile."""

    measurement: dict[str, Any] | None = None


@dataclass(frozen=True)
class Read:
    """Whose recording is analysed."""

    robot: str
    axes: tuple[str, ...]
    simulated: bool


class ErrorInfo(BaseModel):
    """Why a run ended early: a stable code, a sentence, a way out."""

    model_config = ConfigDict(extra="allow", frozen=True)
    code: str
    text: Text
    what: Text = ""
    """What kind of end it is, in general; empty where ``text`` says it."""
    fix: Text
    axes: list[LastSeen] | None = None
    """Of a run whose axes nobody saw at rest: what each was seen to be last."""
    known: list[Text] | None = None
    """What else is known of them."""


@dataclass(frozen=True)
class EndedEarly:
    """Why a run ended without a result, and where its motion stood."""

    type: Literal["stopped", "failed"]
    error: ErrorInfo
    stopped: dict[str, Any] | None = None


# --- from any --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Done:
    """The last word: what came of it."""

    result: Any = field(default_factory=dict)


@dataclass(frozen=True)
class Failed:
    """The last word: the error that ended it."""

    error: BaseException


class Stopped(Exception):
    """Raised in a process that works where somebody asked for the end."""


class Line:
    """The end of a process that works. Telling never waits for whoever reads.

    ``silence_s``: whoever asked counts as gone where nothing comes for so long [s]; ``None``: only where the
    socket ends.
    """

    def __init__(self, connection: Connection, *, silence_s: float | None = None) -> None:
        self._connection, self._silence_s = connection, silence_s
        self.stop = StopFlag()
        self.armed = threading.Event()
        self.orphaned = threading.Event()
        """Whoever asked has gone."""
        self.silent = threading.Event()
        """He is there, but did not speak in time."""
        self._outbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._last_progress = 0.0
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()

    def read_task(self) -> Any:
        """The first message."""
        return self._connection.recv()

    def listen(self, heard: Callable[[Any], None] = lambda message: None) -> None:
        """Start to listen; what is neither ``Stop``, ``Arm`` nor ``Alive`` goes to ``heard``."""
        threading.Thread(target=self._listen, args=(heard,), name="listener", daemon=True).start()

    def _listen(self, heard: Callable[[Any], None]) -> None:
        try:
            while self._is_spoken_to():
                match message := self._connection.recv():
                    case Stop():
                        self.stop.set()
                    case Arm():
                        self.armed.set()
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

    def progress(self, progress: RunProgress, *, always: bool = False) -> None:
        """Queue progress, no more often than it is read; ``always``: at any rate."""
        now = time.monotonic()
        often = now - self._last_progress < PROGRESS_PERIOD_S or self._outbox.qsize() > MOST_WAITING
        if often and not always:
            return
        self._last_progress = now
        self.tell(progress)

    def close(self, longest_s: float | None = None) -> None:
        """Send what is queued, however long that takes unless a time is given [s]."""
        self._outbox.put(None)
        self._writer.join(longest_s)

    def check_stop(self) -> None:
        """Raise ``Stopped`` where the end was asked for."""
        if self.stop.is_set():
            raise Stopped


def line_of_process(*, silence_s: float | None = None) -> Line:
    """The line of a process that ``launch`` started."""
    return Line(Connection(int(sys.argv[1])), silence_s=silence_s)


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
