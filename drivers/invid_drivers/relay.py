"""The parent's side of a measurement whose cycle runs in its own process, ``invid_drivers.realtime``."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from invid.config import CellConfig
from invid.errors import BusError, InvidError, SafetyStop, left_by, note_left
from invid.planning.goal import Judge
from invid.recording import Outcome
from invid.sweep import Progress
from invid_drivers.cia402.bus import STOPPED_S
from invid_drivers.filing import Filing, Teller
from invid_drivers.protocol import Alive, AxisStates, Done, Failed, Process, Stop, launch
from invid_drivers.readiness import known_after_death
from invid_drivers.stopping_budgets import Wish

KEEP_ALIVE_S = 1.0
"""A parent from which nothing came for so long counts as gone. It speaks ten times as often; a busy computer
may hold a process up for some tenths of a second."""
STOP_S = STOPPED_S + KEEP_ALIVE_S + 1.0
"""Longest way of the cycle process to its end when it is to stop, or its parent leaves, which it notices
within its keep-alive. Then it is killed, and heartbeat loss stops the drives."""
ALL_OFF = "it left no axis under power"
"""Said to whoever ends a run at once."""
DIED = (
    ": the drives stop by their heartbeat watch; make sure that they have, and look into the system's log. "
    "An axis that carries a load is held by its drive then: `invid check` says which are energised"
)
SPEAK_S = 0.1
"""The cycle process is told so often that this one is there."""


@dataclass(frozen=True)
class CycleTask:
    """What the cycle process is to do, and for whom."""

    parent: int
    """Its process id."""
    config: CellConfig
    out: Path
    wish: Wish
    is_judged: bool
    """Whether somebody says how many experiments are needed."""


@dataclass(frozen=True)
class Listeners:
    """Who hears of a measurement while it lasts, and who may stop it."""

    progress: Callable[[Progress], None] | None = None
    seen: Callable[[AxisStates], None] | None = None
    stop: threading.Event = field(default_factory=threading.Event)


def measure_in_process(
    config: CellConfig, out: Path, wish: Wish, listeners: Listeners, judge: Judge | None = None
) -> Any:
    """Measure with the cycle in a process of its own; return its ``MeasurementResult``.

    ``judge`` runs here, beside the relay.
    """
    task = CycleTask(os.getpid(), config, out, wish, judge is not None)
    process = launch("invid_drivers.realtime", task)
    relay = Relay(Filing(out, judge), listeners)
    try:
        result = relay.run(process.connection)
    except BaseException as error:
        lost = isinstance(error, (EOFError, ConnectionError)) and not isinstance(error, InvidError)
        status = process.child.poll()
        ended = BusError(f"the cycle process ended unexpectedly (exit {status}){DIED}") if lost else error
        failure = _end(relay, process, ended)
        if process.child.returncode:  # it was killed, or died: nobody has told
            names = [a.name for a in config.axes]
            note_left(ended, (*(a.sentence for a in relay.states.of(names)), *known_after_death(config, 0.0)))
        if failure is not None and failure is not ended:
            note_left(ended, (str(failure),))
        raise ended from None
    failure = _end(relay, process, None)
    if failure is not None:
        raise failure
    return result


def _end(relay: Relay, process: Process, error: BaseException | None) -> InvidError | None:
    """Let the child stop the drives, and note in an error what it says of them; then close the file."""
    child = process.child
    try:
        if error is not None:
            left = relay.last_words(process.connection)
            note_left(error, (s for s in left if s != ALL_OFF or isinstance(error, KeyboardInterrupt)))
        relay.end()
    finally:
        process.connection.close()
    try:
        child.wait(timeout=max(relay.patience_s, 1.0))
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
        if error is not None:
            note_left(error, (f"the cycle process did not end within {STOP_S:.0f} s and was killed{DIED}",))
    return relay.close()


class Relay:
    """The parent's side: tells the cycle process to stop, and passes on its rows, progress and result.

    Nothing here waits for disk, judge or terminal: the file has its own thread, and so has who is told.
    """

    def __init__(self, filing: Filing, listeners: Listeners) -> None:
        self._filing = filing
        self._stop = listeners.stop
        self._leaving = threading.Event()
        """This side ends without a stop of its own: a second Ctrl-C, a fault."""
        self._over = threading.Event()
        self._asked: float | None = None
        self._ended: Done | Failed | None = None
        self._outcome = Outcome.FAILED
        self._teller = Teller(listeners.progress, listeners.seen)
        self._speaker: threading.Thread | None = None
        self.states = AxisStates()
        """Of the axes, as they were told last."""

    def run(self, connection: Connection) -> Any:
        """Relay until the result is there; raises what the child raised, or what the file did."""
        self.speak_to(connection)
        ended = self._await_end(connection)
        if isinstance(ended, Done):
            self._outcome = Outcome.COMPLETED
            self._raise_of_file()
            return ended.result
        if isinstance(ended.error, SafetyStop):
            self._raise_of_file()  # that is why it was stopped
            self._outcome = Outcome.ABORTED
        raise ended.error

    def _await_end(self, connection: Connection) -> Done | Failed:
        """Pass on what the cycle process says, until its result or its error.

        BusError where it does not come within ``STOP_S`` of a stop.
        """
        while self._ended is None:
            if self._asked is None and self._is_to_stop:
                self._asked = time.monotonic()
            if self.patience_s <= 0.0:
                raise BusError(f"the cycle process did not stop within {STOP_S:.0f} s")
            if not connection.poll(SPEAK_S):
                continue
            match message := connection.recv():
                case Done() | Failed():
                    self._ended = message
                case AxisStates():
                    self.states = message
                    self._teller.tell(message)
                case Progress():
                    self._teller.tell(message)
                case _:
                    self._filing.put(message)
        return self._ended

    @property
    def patience_s(self) -> float:
        """So long the cycle process may go on yet [s]."""
        waited = 0.0 if self._asked is None else time.monotonic() - self._asked
        return STOP_S - waited

    @property
    def _is_to_stop(self) -> bool:
        return self._stop.is_set() or self._leaving.is_set() or self._filing.error is not None

    def last_words(self, connection: Connection) -> tuple[str, ...]:
        """Stop the cycle process, if it has not ended, and return what it knows of its axes then."""
        self._leaving.set()
        try:
            ended = self._await_end(connection)
        except (EOFError, OSError):  # it has gone, or hangs
            return ()
        return tuple(ended.result.warnings) if isinstance(ended, Done) else left_by(ended.error) or (ALL_OFF,)

    def _raise_of_file(self) -> None:
        if self._filing.error is not None:
            self._outcome = Outcome.FAILED
            raise self._filing.error

    def speak_to(self, connection: Connection) -> None:
        """Begin to tell the cycle process that this one is there."""
        self._speaker = threading.Thread(target=self._speak, args=(connection,), daemon=True)
        self._speaker.start()

    def _speak(self, connection: Connection) -> None:
        """Tell the cycle process that this one is there, of a stop, and what the judge answers."""
        asked = False
        with contextlib.suppress(OSError):  # the cycle process has gone: the receiving end notices
            while not self._over.is_set():
                if not asked and self._is_to_stop:
                    asked = True
                    connection.send(Stop())
                connection.send(Alive())
                while (verdict := self._filing.verdict()) is not None:
                    connection.send(verdict)
                if asked:
                    self._over.wait(SPEAK_S)
                else:
                    self._stop.wait(SPEAK_S)

    def end(self) -> None:
        """Say nothing more to the cycle process, and tell what progress is left."""
        self._over.set()
        if self._speaker is not None:
            self._speaker.join(2 * SPEAK_S)
        self._teller.end()

    def close(self) -> InvidError | None:
        """Write what is left, mark and close the file, if one was opened; however long the disk takes."""
        return self._filing.close(self._outcome)
