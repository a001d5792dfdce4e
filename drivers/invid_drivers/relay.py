"""The parent's side of a measurement whose cycle runs in its own process, ``invid_drivers.realtime``."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from invid.config import CellConfig
from invid.errors import BusError, InvidError, SafetyStop
from invid.model.chains import CoupledChains
from invid.planning.belief import Belief
from invid.planning.model import Plan
from invid.recording import Outcome, Recording
from invid.sweep import Progress
from invid_drivers.filing import Filing, Teller

STOP_S = 30.0
"""Longest way of the cycle process to its end when its parent leaves: fade, quick stop, two seconds for each
drive that does not answer, restoring objects. Then it is killed, and heartbeat loss stops the drives."""
SPEAK_S = 0.1
"""The cycle process is told so often that this one is there: ten times within its keep-alive."""


def measure_in_process(  # noqa: PLR0913 - as measure_to_file
    config: CellConfig,
    out: Path,
    *,
    axes: Sequence[str] | None,
    amplitude_scale: float,
    progress: Callable[[Progress], None] | None,
    stop: threading.Event | None,
    model: CoupledChains | Belief | None,
    plan: Plan | None = None,
    go_on: Callable[[Recording], bool] | None = None,
) -> Any:
    """Measure with the cycle in a process of its own; return its ``MeasurementResult``.

    ``go_on`` runs here, beside the relay, while the cycle process holds the axes.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        child = subprocess.Popen(
            [sys.executable, "-m", "invid_drivers.realtime", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
    connection = Connection(ours.detach())
    relay = Relay(Filing(out, go_on), stop, progress)
    try:
        connection.send(
            {
                "parent": os.getpid(),
                "config": config.model_dump(mode="python"),
                "out": str(out),
                "axes": None if axes is None else list(axes),
                "amplitude_scale": amplitude_scale,
                "model": model,
                "plan": plan,
                "judged": go_on is not None,
            }
        )
        result = relay.run(connection)
    except (EOFError, ConnectionError) as error:
        if isinstance(error, InvidError):
            raise _with_file(error, _end(relay, connection, child)) from None
        failed = BusError(
            f"the cycle process ended unexpectedly (exit {child.poll()}): the drives stop by their heartbeat "
            "watch; make sure that they have, and look into the system's log. An axis that carries a load is "
            "held by its drive then: `invid check` says which are energised"
        )
        raise _with_file(failed, _end(relay, connection, child)) from None
    except InvidError as error:
        raise _with_file(error, _end(relay, connection, child)) from None
    except BaseException:
        _end(relay, connection, child)
        raise
    failure = _end(relay, connection, child)
    if failure is not None:
        raise failure
    return result


def _end(relay: Relay, connection: Connection, child: subprocess.Popen[bytes]) -> InvidError | None:
    """Let the child stop the drives by closing the socket, then close the file."""
    relay.end()
    connection.close()
    try:
        child.wait(timeout=STOP_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    return relay.close()


def _with_file(error: InvidError, failure: InvidError | None) -> InvidError:
    """The error that ended the run, with what became of its file where that failed too."""
    return error if failure is None or failure is error else error.saying(f"{error}. {failure}")


class Relay:
    """The parent's side: tells the cycle process to stop, and passes on its rows, progress and result.

    Nothing here waits for disk, judge or terminal: the file has its own thread, and so has who is told.
    """

    def __init__(
        self,
        filing: Filing,
        stop: threading.Event | None,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        self._filing = filing
        self._stop = stop if stop is not None else threading.Event()
        self._over = threading.Event()
        self._outcome = Outcome.FAILED
        self._teller = Teller(progress)
        self._speaker: threading.Thread | None = None

    def run(self, connection: Connection) -> Any:
        """Relay until the result is there; raises what the child raised, or what the file did."""
        self._speaker = threading.Thread(target=self._speak, args=(connection,), daemon=True)
        self._speaker.start()
        while True:
            message = connection.recv()
            kind = message[0]
            if kind == "progress":
                self._teller.tell(message[1])
            elif kind == "result":
                self._outcome = Outcome.COMPLETED
                self._raise_of_file()
                return message[1]
            elif kind == "error":
                if isinstance(message[1], SafetyStop):
                    self._raise_of_file()  # that is why it was stopped
                    self._outcome = Outcome.ABORTED
                raise message[1]
            else:
                self._filing.put(message)

    def _raise_of_file(self) -> None:
        if self._filing.error is not None:
            self._outcome = Outcome.FAILED
            raise self._filing.error

    def _speak(self, connection: Connection) -> None:
        """Tell the cycle process that this one is there, of a stop, and what the judge answers."""
        asked = False
        with contextlib.suppress(OSError):  # the cycle process has gone: the receiving end notices
            while not self._over.is_set():
                if not asked and (self._stop.is_set() or self._filing.error is not None):
                    asked = True
                    connection.send("stop")
                connection.send("alive")
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
