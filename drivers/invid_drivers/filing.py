"""What comes from the cycle process, to file, by a thread of its own: a disk may stall, a stop may not."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InvidError, RecordingError
from invid.planning.goal import Judge
from invid.recording import Outcome, Recording, RecordingWriter, read_recording
from invid.sweep import Progress, Sample
from invid.sweep.recorder import Recorder
from invid_drivers.protocol import Ask, AxisStates, Begin, Finish, Judgement, Open, Rows

QUEUE_BYTES = 64 << 20
"""Rows that may wait for the disk: 3 minutes of eight axes at 1 kHz. Beyond that the measurement ends."""
MOST_NEWS, LAST_NEWS_S = 100, 0.2
"""Progress that waits for a terminal: twenty seconds of it, and how long the end waits for it."""


def row_format(axes: int) -> np.dtype[Any]:
    """One cycle on its way to the file."""
    per_axis = (("position", "<f8"), ("torque", "<f8"), ("demand", "<f8"), ("status", "<u2"), ("fresh", "?"))
    return np.dtype([("slot", "<i8"), ("time", "<f8"), *((name, code, (axes,)) for name, code in per_axis)])


class Judged:
    """A recording that is being written, and who judges it, if anybody does."""

    def __init__(self, out: Path, header: Recording, judge: Judge | None) -> None:
        self._out, self._header, self._judge = out, header, judge
        self._writer: RecordingWriter | None = None

    def open(self) -> RecordingWriter:
        """Open the file, with the first row."""
        self._writer = RecordingWriter(self._out, self._header)
        return self._writer

    def ask(self) -> bool:
        """Whether the next experiment is needed, by the rows of those that have ended."""
        if self._writer is None or self._judge is None:
            return True
        return self._judge(read_recording(self._writer.rows_file))

    def ask_later(self) -> Callable[[], bool]:
        """The same with the answer to the question before, for the next experiment goes on meanwhile."""
        answers = [True]

        def ask() -> bool:
            answers.append(answers[-1] and self.ask())
            return answers[-2]

        return ask


class Filing:
    """Thread that writes the messages of the cycle process to the recording, in their order.

    ``error`` is set where the disk takes no more, or not fast enough; rows that come after that are dropped.
    """

    def __init__(self, out: Path, judge: Judge | None) -> None:
        self._out, self._judge = out, judge
        self.error: InvidError | None = None
        self._messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._verdicts: queue.SimpleQueue[Judgement] = queue.SimpleQueue()
        self._waiting = 0
        self._lock = threading.Lock()
        self._judged: Judged | None = None
        self._recorder: Recorder | None = None
        self._row_format = row_format(0)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, message: Any) -> None:
        """Queue a message for the file; never waits."""
        if isinstance(message, Rows):
            if self.error is not None:
                return
            with self._lock:
                full = self._waiting + len(message.packed) > QUEUE_BYTES
                self._waiting += 0 if full else len(message.packed)
            if full:
                self.error = RecordingError(
                    f"{self._out}: the disk has taken nothing while {QUEUE_BYTES >> 20} MiB of rows came; "
                    "the measurement was ended, and what came after them is lost. Use a faster disk"
                )
                return
        self._messages.put(message)

    def verdict(self) -> Judgement | None:
        """The next answer of the judge."""
        return None if self._verdicts.empty() else self._verdicts.get()

    def close(self, outcome: Outcome) -> InvidError | None:
        """Wait for the disk, then mark and close the file; what went wrong with it, if anything did."""
        self._messages.put(outcome)
        while self._thread.is_alive():
            self._thread.join(0.1)  # in pieces: Ctrl-C must come through
        return self.error

    def _work(self) -> None:
        try:
            while not isinstance(message := self._messages.get(), Outcome):
                try:
                    self._take(message)
                except InvidError as error:
                    self.error = self.error or error
                if isinstance(message, Rows):
                    with self._lock:
                        self._waiting -= len(message.packed)
            self._end(message)
        except InvidError as error:
            self.error = error
        except Exception as error:  # whoever closes hears of it
            self.error = RecordingError(f"{self._out}: cannot be written: {type(error).__name__}: {error}")

    def _take(self, message: Any) -> None:
        recorder = self._recorder
        match message:
            case Open(header=header, cycle_s=cycle_s):
                self._open(header, cycle_s)
            case Ask():
                # here, because what it judges was written by now; in a thread, for the judge takes its time
                threading.Thread(target=self._give_verdict, daemon=True).start()
            case Begin(experiment=experiment, hold_gain=gain, scale=scale) if recorder is not None:
                recorder.begin(experiment, gain, scale)
            case Finish() if recorder is not None:
                recorder.end()
            case Rows(packed=packed) if recorder is not None and self.error is None:
                self._record(recorder, packed)

    def _record(self, recorder: Recorder, packed: bytes) -> None:
        for slot, time, position, torque, demand, status, fresh in np.frombuffer(packed, self._row_format):
            sample = Sample(
                int(slot), float(time), position.tolist(), torque.tolist(), status.tolist(), fresh.tolist()
            )
            recorder.row(sample, demand.tolist())

    def _open(self, header: Recording, cycle_s: float) -> None:
        count = len(header.axes)
        self._row_format = row_format(count)
        self._judged = Judged(self._out, header, self._judge)
        self._recorder = Recorder(self._judged.open, cycle_s, count)

    def _give_verdict(self) -> None:
        """Ask the judge whether the next experiment is needed; a judge that fails ends nothing."""
        needed = True
        try:
            needed = self._judged is None or self._judged.ask()
        finally:
            self._verdicts.put(Judgement(needed))

    def _end(self, outcome: Outcome) -> None:
        if self._recorder is None:
            return
        try:
            self._recorder.end()
        finally:
            self._recorder.close(outcome if self.error is None else Outcome.FAILED)


class Teller:
    """Thread that passes news to whoever wants to know: a terminal that stands makes nobody wait."""

    def __init__(
        self, progress: Callable[[Progress], None] | None, seen: Callable[[AxisStates], None] | None
    ) -> None:
        self._progress, self._seen = progress, seen
        self._news: queue.SimpleQueue[Progress | AxisStates | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def tell(self, news: Progress | AxisStates) -> None:
        """Queue news; never waits, and progress that nobody takes is not kept for long."""
        if isinstance(news, AxisStates) or self._news.qsize() < MOST_NEWS:
            self._news.put(news)

    def end(self) -> None:
        """Pass on what is left where that takes no longer than a moment."""
        self._news.put(None)
        self._thread.join(LAST_NEWS_S)

    def _work(self) -> None:
        while (news := self._news.get()) is not None:
            if isinstance(news, AxisStates):
                if self._seen is not None:
                    self._seen(news)
            elif self._progress is not None:
                self._progress(news)
