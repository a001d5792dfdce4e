"""Talk over the pipe between the service and the runner of a job; ``jobs.protocol`` says what goes
over it.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Mapping
from typing import IO, Any

from invid_service.jobs.protocol import Job, Progress, Told

_PROGRESS_PERIOD_S = 0.2
_QUEUE = 200


class Stopped(Exception):
    """Raised in the runner where somebody asked for the end."""


class Line:
    """Both directions of the pipe. Telling never blocks: progress that nobody reads is dropped."""

    def __init__(self, source: IO[bytes], sink: IO[bytes]) -> None:
        self._source, self._sink = source, sink
        self.stop = threading.Event()
        self.armed = threading.Event()
        self.orphaned = threading.Event()
        self._outbox: queue.Queue[Told | None] = queue.Queue()
        self._last_progress = 0.0
        self._writer = threading.Thread(target=self._write, name="writer", daemon=True)
        self._writer.start()

    def read_job(self) -> Job:
        """Read the job from the first line."""
        return Job.model_validate_json(self._source.readline())

    def listen(self) -> None:
        """Start to listen for wishes."""
        threading.Thread(target=self._listen, name="listener", daemon=True).start()

    def _listen(self) -> None:
        for line in self._source:
            kind = json.loads(line).get("type")
            if kind == "arm":
                self.armed.set()
            elif kind == "stop":
                self.stop.set()
        self.orphaned.set()
        self.stop.set()

    def _write(self) -> None:
        while (message := self._outbox.get()) is not None:
            try:
                self._sink.write(message.model_dump_json().encode() + b"\n")
                self._sink.flush()
            except OSError:
                return

    def tell(self, message: Told) -> None:
        """Queue a message."""
        self._outbox.put(message)

    def progress(self, progress: Progress, *, always: bool = False) -> None:
        """Queue progress, at most five times a second and only while it is read; ``always``: at any rate."""
        now = time.monotonic()
        often = now - self._last_progress < _PROGRESS_PERIOD_S or self._outbox.qsize() > _QUEUE
        if often and not always:
            return
        self._last_progress = now
        self.tell(progress)

    def close(self) -> None:
        """Send what is queued."""
        self._outbox.put(None)
        self._writer.join(5.0)

    def check_stop(self) -> None:
        """Raise where the end was asked for."""
        if self.stop.is_set():
            raise Stopped


def plain(document: Mapping[str, Any]) -> Any:
    """Return the document as JSON has it."""
    return json.loads(json.dumps(document, default=float))
