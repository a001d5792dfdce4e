"""The cycle in a process of its own: ``python -m invid_drivers.realtime FD``.

Another busy thread in the same process makes the cycle milliseconds late, so whoever measures (a
command, the service's runner) only relays: this process owns bus and drives, the parent owns the file.

- The parent dies: its end of the socket closes (and the kernel sends SIGTERM), the sweep fades out and
  stops the drives by itself.
- This process dies: its heartbeat ends, and the drives stop by their heartbeat consumer (0x1016).
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

from invid import errors
from invid.arrays import frozen_float
from invid.chains import CoupledChains
from invid.config import CellConfig
from invid.errors import BusError, InvidError, SafetyStop
from invid.plan.model import Plan, PlannedExperiment
from invid.recording import Outcome, Recording, RecordingWriter
from invid.sweep import Progress, Sample
from invid.sweep.recorder import Recorder
from invid_drivers.collecting import Judged
from invid_drivers.memory import lock_memory

PRIORITY = 50
"""SCHED_FIFO priority: above everything ordinary, below the kernel's own threads."""
SWITCH_S = 0.0001
"""After this long the thread that sends must give the interpreter's lock back to the cycle."""
_PR_SET_PDEATHSIG = 1
STOP_S = 30.0
"""Longest way of the cycle process to its end when its parent leaves: fade, quick stop, two seconds for each
drive that does not answer, restoring objects. Then it is killed, and heartbeat loss stops the drives."""
RELAY_POLL_S = 0.05
POST_S = 0.05
"""Rows leave the cycle process this often: what a sudden death of it may cost."""


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


def leave_by(stop: threading.Event) -> None:
    """What a terminal or the system may send ends in an orderly stop, never in the sudden end of the cycle.

    A terminal sends to the whole group, so here too: Ctrl-C and Ctrl-Z, which the parent relays, and hanging
    up (a closed terminal, a lost SSH connection) and Ctrl-\\, which may have ended the parent already.
    """
    for number in (signal.SIGINT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, lambda *_: stop.set())


def row_format(axes: int) -> np.dtype[Any]:
    """One cycle on its way to the parent."""
    per_axis = (("position", "<f8"), ("torque", "<f8"), ("demand", "<f8"), ("status", "<u2"), ("fresh", "?"))
    return np.dtype([("slot", "<i8"), ("time", "<f8"), *((name, code, (axes,)) for name, code in per_axis)])


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


def child_main(fd: int) -> None:
    """Run one measurement; everything goes back over the socket ``fd``."""
    from invid_drivers.measurement import run_measurement, start_measurement

    stop = threading.Event()
    leave_by(stop)
    connection = Connection(fd)
    task: Mapping[str, Any] = connection.recv()
    die_with_parent(task["parent"])
    outbox: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
    answers: dict[int, bool | None] = {}

    def listen() -> None:
        try:
            with contextlib.suppress(EOFError, OSError):
                while isinstance(message := connection.recv(), tuple):
                    answers[message[0]] = message[1]
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
            model=task["model"],
        )
        outbox.put(("result", result))
    except InvidError as error:
        outbox.put(("error", type(error).__name__, str(error)))
    except Exception as error:  # the parent must hear of it: its exit status depends on it
        outbox.put(("error", "RuntimeError", f"{type(error).__name__}: {error}"))
    outbox.put(None)
    # The drives are off. However far behind the parent is, every sample reaches it; once it has gone,
    # sending fails and this ends.
    sender.join()


def measure_in_process(
    config: CellConfig,
    out: Path,
    *,
    axes: Sequence[str] | None,
    amplitude_scale: float,
    progress: Callable[[Progress], None] | None,
    stop: threading.Event | None,
    model: CoupledChains | None,
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
    relay = _Relay(out, go_on)
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
        return relay.run(connection, progress, stop)
    except (EOFError, ConnectionError) as error:
        if isinstance(error, InvidError):
            raise
        raise BusError(
            f"the cycle process ended unexpectedly (exit {child.poll()}): the drives stop by their heartbeat "
            "watch; make sure that they have, and look into the system's log"
        ) from None
    finally:
        # Closing the socket stops the child if it still runs; then the file.
        connection.close()
        try:
            child.wait(timeout=STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        relay.close()


class _Relay:
    """The parent's side: messages to file, progress and result."""

    def __init__(self, out: Path, go_on: Callable[[Recording], bool] | None = None) -> None:
        self._out, self._go_on = out, go_on
        self._judged: Judged | None = None
        self._verdicts: queue.SimpleQueue[tuple[int, bool]] = queue.SimpleQueue()
        self._recorder: Recorder | None = None
        self._row_format = row_format(0)
        self._outcome = Outcome.FAILED

    def run(
        self,
        connection: Connection,
        progress: Callable[[Progress], None] | None,
        stop: threading.Event | None,
    ) -> Any:
        """Relay until the result is there; raises what the child raised."""
        asked = False
        while True:
            if stop is not None and stop.is_set() and not asked:
                asked = True
                connection.send("stop")
            while not self._verdicts.empty():
                connection.send(self._verdicts.get())
            if not connection.poll(RELAY_POLL_S):
                continue
            message = connection.recv()
            kind = message[0]
            if kind == "progress":
                if progress is not None:
                    progress(message[1])
            elif kind == "open":
                self._open(*message[1:])
            elif kind == "ask":
                threading.Thread(target=self._judge, args=message[1:], daemon=True).start()
            elif kind == "result":
                self._outcome = Outcome.COMPLETED
                return message[1]
            elif kind == "error":
                known = getattr(errors, message[1], None)
                if isinstance(known, type) and issubclass(known, InvidError):
                    if issubclass(known, SafetyStop):
                        self._outcome = Outcome.ABORTED
                    raise known(message[2])
                raise RuntimeError(message[2])
            elif self._recorder is not None:
                self._record(self._recorder, kind, message)

    def _open(self, header: Recording, cycle_s: float) -> None:
        count = len(header.axes)
        self._row_format = row_format(count)
        if self._go_on is None:
            self._recorder = Recorder(lambda: RecordingWriter(self._out, header), cycle_s, count)
            return
        self._judged = Judged(self._out, header, self._go_on)
        self._recorder = Recorder(self._judged.open, cycle_s, count)

    def _judge(self, number: int) -> None:
        """Answer whether the next experiment is needed; a judge that fails ends nothing."""
        needed = True
        try:
            needed = self._judged is None or self._judged.ask(number)
        finally:
            self._verdicts.put((number, needed))

    def _record(self, recorder: Recorder, kind: str, message: tuple[Any, ...]) -> None:
        if kind == "begin":
            recorder.begin(*message[1:])
        elif kind == "end":
            recorder.end()
        elif kind == "rows":
            for slot, time, position, torque, demand, status, fresh in np.frombuffer(
                message[1], dtype=self._row_format
            ):
                sample = Sample(
                    int(slot),
                    float(time),
                    position.tolist(),
                    torque.tolist(),
                    status.tolist(),
                    fresh.tolist(),
                )
                recorder.row(sample, demand.tolist())

    def close(self) -> None:
        """Write what is left, mark and close the file, if one was opened."""
        if self._recorder is not None:
            try:
                self._recorder.end()
            finally:
                self._recorder.close(self._outcome)


if __name__ == "__main__":
    child_main(int(sys.argv[1]))
