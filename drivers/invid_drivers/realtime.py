"""The cycle in a process of its own: ``python -m invid_drivers.realtime FD``.

Another busy thread in the same process makes the cycle milliseconds late, so whoever measures (a
command, the service's runner) only relays: this process owns bus and drives, the parent owns the file.

- The parent dies: its end of the socket closes (and the kernel sends SIGTERM), the sweep fades out and
  stops the drives by itself.
- The parent no longer answers (it was stopped, its computer starved it): so it does when nothing has come
  from it for ``KEEP_ALIVE_S``.
- This process dies: its heartbeat ends, and the drives stop by their heartbeat consumer (0x1016).

What a stop waits for is this process alone: the parent relays it from a thread that touches neither disk nor
terminal, and Ctrl-C in a terminal comes here directly as well.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import queue
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.errors import BusError, InvidError, SafetyStop
from invid.model.chains import CoupledChains
from invid.numerics.arrays import frozen_float
from invid.planning.belief import Belief
from invid.planning.model import Plan, PlannedExperiment
from invid.recording import Outcome, Recording
from invid.sweep import Progress, Sample
from invid_drivers.filing import Filing, Teller
from invid_drivers.memory import lock_memory
from invid_drivers.stop_flag import StopFlag

PRIORITY = 50
"""SCHED_FIFO priority: above everything ordinary, below the kernel's own threads."""
SWITCH_S = 0.0001
"""After this long the thread that sends must give the interpreter's lock back to the cycle."""
_PR_SET_PDEATHSIG = 1
STOP_S = 30.0
"""Longest way of the cycle process to its end when its parent leaves: fade, quick stop, two seconds for each
drive that does not answer, restoring objects. Then it is killed, and heartbeat loss stops the drives."""
POST_S = 0.05
"""Rows leave the cycle process this often: what a sudden death of it may cost."""
KEEP_ALIVE_S = 1.0
"""A parent from which nothing came for so long counts as gone. It speaks ten times as often; a busy computer
may hold a process up for some tenths of a second."""
SPEAK_S = 0.1
SECOND_LOOK_S = 0.1
"""Within the keep-alive: where the whole computer stood still, the parent gets this long to speak again."""


def make_realtime() -> tuple[str, ...]:
    """SCHED_FIFO, locked memory, no garbage collection; what the system did not allow, in words."""
    notes = []
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_S)
    try:
        # Every thread: one of ordinary priority that is interrupted while it holds the interpreter's lock
        # would make the cycle wait for the whole machine.
        for thread in map(int, os.listdir("/proc/self/task")):
            own = thread == threading.get_native_id()
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(PRIORITY - (not own)))
    except (OSError, AttributeError):
        notes.append(
            "the system does not allow SCHED_FIFO (run as root or grant CAP_SYS_NICE): expect milliseconds "
            "of jitter"
        )
    if not lock_memory():
        notes.append("memory is not locked (RLIMIT_MEMLOCK is limited)")
    return tuple(notes)


def die_with_parent(parent: int) -> None:
    """SIGTERM from the kernel when the parent dies, however it dies."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it died before the line above
        os.kill(os.getpid(), signal.SIGTERM)


def leave_by(stop: StopFlag) -> None:
    """What a terminal or the system may send ends in an orderly stop, never in the sudden end of the cycle.

    A terminal sends to the whole group, so here too: Ctrl-C, Ctrl-Z, Ctrl-\\, and hanging up (a closed
    terminal, a lost SSH connection). The parent, which relays them as well, may hang in a disk or have ended.
    """
    for number in (signal.SIGINT, signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, lambda *_: stop.set())


class RemoteSink:
    """The sweep's sink in the cycle process: packs rows, and leaves gaps and file to the parent.

    Filling gaps and compressing take milliseconds, which the cycle has not; and rows that have left this
    process survive it.
    """

    def __init__(self, send: Callable[[tuple[Any, ...]], None], cycle_s: float, axes: int) -> None:
        self._send = send
        # row_format, packed
        self._pack = struct.Struct(f"<qd{3 * axes}d{axes}H{axes}?").pack
        self._rows: list[bytes] = []
        self._most = max(1, round(POST_S / cycle_s))

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        """As ``Recorder.begin``; the planned torque stays here."""
        none = frozen_float(np.zeros((0, len(hold_gain))))
        self._send(("begin", replace(experiment, torque=none, reference=None), list(hold_gain), scale))

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        """As ``Recorder.row``."""
        self._rows.append(
            self._pack(
                sample.slot,
                sample.time,
                *sample.position,
                *sample.torque,
                *demand,
                *sample.status,
                *sample.fresh,
            )
        )
        if len(self._rows) >= self._most:
            self._post()

    def _post(self) -> None:
        if self._rows:
            self._send(("rows", b"".join(self._rows)))
            self._rows.clear()

    def end(self) -> None:
        """As ``Recorder.end``."""
        self._post()
        self._send(("end",))

    def close(self, outcome: Outcome) -> None:
        """The parent closes, when it knows how the run ended."""
        self._post()


SILENT = f"the command that started the measurement did not answer for {KEEP_ALIVE_S:g} s"


def spoke(connection: Connection) -> bool:
    """Whether the parent says something within its keep-alive."""
    return connection.poll(KEEP_ALIVE_S - SECOND_LOOK_S) or connection.poll(SECOND_LOOK_S)


def child_main(fd: int) -> None:
    """Run one measurement; everything goes back over the socket ``fd``."""
    from invid_drivers.measurement import run_measurement, start_measurement

    stop = StopFlag()
    leave_by(stop)
    connection = Connection(fd)
    task: Mapping[str, Any] = connection.recv()
    die_with_parent(task["parent"])
    outbox: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
    answers: dict[int, bool | None] = {}

    silent = threading.Event()

    def listen() -> None:
        try:
            with contextlib.suppress(EOFError, OSError):
                while spoke(connection):
                    message = connection.recv()
                    if message == "stop":
                        return
                    if isinstance(message, tuple):
                        answers[message[0]] = message[1]
                silent.set()
        finally:
            stop.set()  # whatever ended this thread: nobody could stop the axes any more

    def ask(number: int) -> bool | None:
        if number not in answers:
            answers[number] = None
            outbox.put(("ask", number))
        return answers[number]

    def post() -> None:
        while (message := outbox.get()) is not None:
            with contextlib.suppress(OSError):  # the parent is gone; the drives are stopped all the same
                connection.send(message)

    threading.Thread(target=listen, daemon=True).start()
    sender = threading.Thread(target=post, daemon=True)
    sender.start()
    config = CellConfig.model_validate(task["config"])
    try:
        plan, cell = start_measurement(
            config, task["axes"], task["amplitude_scale"], task["model"], task["plan"]
        )
        notes = make_realtime()

        def open_sink(header: Recording) -> RemoteSink:
            outbox.put(("open", header, plan.cycle_s))
            return RemoteSink(outbox.put, plan.cycle_s, len(plan.axes))

        result = run_measurement(
            config,
            plan,
            cell,
            Path(task["out"]),
            progress=lambda p: outbox.put(("progress", p)),
            stop=stop,
            open_sink=open_sink,
            notes=notes,
            asked=ask if task["judged"] else None,
        )
        outbox.put(("result", result))
    except SafetyStop as error:
        outbox.put(("error", error.saying(f"{SILENT}: {error}") if silent.is_set() else error))
    except InvidError as error:
        outbox.put(("error", error))
    except Exception as error:  # the parent must hear of it: its exit status depends on it
        outbox.put(("error", RuntimeError(f"{type(error).__name__}: {error}")))
    outbox.put(None)
    # The drives are off. However far behind the parent is, every sample reaches it; once it has gone,
    # sending fails and this ends.
    sender.join()


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
    """``MeasurementResult`` of a measurement whose cycle runs in its own process.

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
    """The drives first: closing the socket stops the child if it still runs; then the file."""
    relay.end()
    connection.close()
    try:
        child.wait(timeout=STOP_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    return relay.close()


def _with_file(error: InvidError, failure: InvidError | None) -> InvidError:
    """What ended the run, and what became of its file where that failed too."""
    return error if failure is None or failure is error else error.saying(f"{error}. {failure}")


class Relay:
    """The parent's side: a stop to the cycle process, what comes from it to file, progress and result.

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
        """Say that this process is there, and what it has to say, until all is over."""
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
        """Nothing more is said."""
        self._over.set()
        if self._speaker is not None:
            self._speaker.join(2 * SPEAK_S)
        self._teller.end()

    def close(self) -> InvidError | None:
        """Write what is left, mark and close the file, if one was opened; however long the disk takes."""
        return self._filing.close(self._outcome)


if __name__ == "__main__":
    child_main(int(sys.argv[1]))
