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
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from invid.errors import InvidError, SafetyStop, left_by, note_left
from invid.numerics.arrays import frozen_float
from invid.planning.model import PlannedExperiment
from invid.recording import Outcome, Recording
from invid.sweep import Sample
from invid_drivers.connect import connect
from invid_drivers.measurement import run_measurement
from invid_drivers.protocol import (
    Ask,
    AxisStates,
    Begin,
    Done,
    Failed,
    Finish,
    Judgement,
    LastSeen,
    Line,
    Open,
    Rows,
)
from invid_drivers.relay import KEEP_ALIVE_S, CycleTask
from invid_drivers.scheduling import lock_memory
from invid_drivers.stop_flag import StopFlag

PRIORITY = 50
"""SCHED_FIFO priority: above everything ordinary, below the kernel's own threads."""
SWITCH_S = 0.0001
"""After this long the thread that sends must give the interpreter's lock back to the cycle."""
_PR_SET_PDEATHSIG = 1
POST_S = 0.05
"""Rows leave the cycle process this often: what a sudden death of it may cost."""


def make_realtime() -> tuple[str, ...]:
    """Ask for SCHED_FIFO, locked memory, no garbage collection; return in words what was not allowed."""
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
    """Ask the kernel for SIGTERM when the parent dies, however it dies."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it died before the line above
        os.kill(os.getpid(), signal.SIGTERM)


def leave_by(stop: StopFlag) -> None:
    """Turn what a terminal or the system may send into an orderly stop, never a sudden end of the cycle.

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

    def __init__(self, tell: Callable[[Any], None], cycle_s: float, count: int) -> None:
        self._tell = tell
        # row_format, packed
        self._pack = struct.Struct(f"<qd{3 * count}d{count}H{count}?").pack
        self._rows: list[bytes] = []
        self._most = max(1, round(POST_S / cycle_s))

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        """Send the start of an experiment to the parent; the planned torque stays here."""
        none = frozen_float(np.zeros((0, len(hold_gain))))
        self._tell(Begin(replace(experiment, torque=none, reference=None), list(hold_gain), scale))

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        """Pack one row, and send the rows that have gathered."""
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
            self._tell(Rows(b"".join(self._rows)))
            self._rows.clear()

    def end(self) -> None:
        """Send the rows that are left and the end of the experiment."""
        self._post()
        self._tell(Finish())

    def close(self, outcome: Outcome) -> None:
        """Send the rows that are left; the parent closes, when it knows how the run ended."""
        self._post()


SILENT = f"the command that started the measurement did not answer for {KEEP_ALIVE_S:g} s"


def main() -> None:
    """Run one measurement; everything goes back over the line."""
    line = Line.of_process(silence_s=KEEP_ALIVE_S)
    leave_by(line.stop)
    task: CycleTask = line.read_task()
    die_with_parent(task.parent)
    enough = threading.Event()

    def heard(message: Judgement) -> None:
        if not message.needs_more:
            enough.set()

    def ask() -> bool:
        line.tell(Ask())
        return not enough.is_set()

    line.listen(heard)
    config = task.config
    try:
        cycle_s = config.bus.cycle_s

        def open_sink(header: Recording) -> tuple[RemoteSink, tuple[str, ...]]:
            line.tell(Open(header, cycle_s))
            return RemoteSink(line.tell, cycle_s, len(header.axes)), make_realtime()

        def seen(states: dict[str, str]) -> None:
            line.tell(AxisStates(tuple(LastSeen(axis, state, time.time()) for axis, state in states.items())))

        cell = connect(config)
        cell.seen = seen
        result = run_measurement(
            config,
            task.wish,
            cell,
            task.out,
            progress=line.tell,
            stop=line.stop,
            open_sink=open_sink,
            asked=ask if task.is_judged else None,
        )
        line.tell(Done(result))
    except SafetyStop as error:
        note_left(error, (SILENT,) * line.silent.is_set())
        line.tell(Failed(error))
    except InvidError as error:
        line.tell(Failed(error))
    except Exception as error:  # the parent must hear of it: its exit status depends on it
        told = RuntimeError(f"{type(error).__name__}: {error}")
        note_left(told, left_by(error))
        line.tell(Failed(told))
    # The drives are off. However far behind the parent is, every sample reaches it; once it has gone,
    # sending fails and this ends.
    line.close()


if __name__ == "__main__":
    main()
