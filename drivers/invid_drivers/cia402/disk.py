"""Writes to disk that no cycle waits for, each with what its failure would mean."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from invid.errors import BusError
from invid.wording.sentence import sentence

PATIENCE_S = 10.0
"""Longest wait for a disk while no axis is energised."""


def unwritten(file: str, error: OSError, meaning: str) -> BusError:
    """What to raise where a file cannot be written."""
    return BusError(
        sentence(
            "{file}: cannot be written ({strerror}){meaning}",
            file=file,
            strerror=error.strerror,
            meaning=meaning,
        )
    )


class Disk:
    """Does one write after another in a thread of its own."""

    def __init__(self) -> None:
        self._todo: queue.SimpleQueue[tuple[Callable[[], None], str, str]] = queue.SimpleQueue()
        self._failed: list[BusError] = []
        self._idle = threading.Event()
        self._idle.set()
        self._left = 0
        self._lock = threading.Lock()
        self._deferred = False

    def put(self, write: Callable[[], None], file: str, meaning: str) -> None:
        """Queue a write and wait for it unless deferred. BusError where it failed, with what that means, or
        takes too long."""
        with self._lock:
            if not self._left:
                threading.Thread(target=self._work, name="disk", daemon=True).start()
            self._left += 1
            self._idle.clear()
        self._todo.put((write, file, meaning))
        if not self._deferred:
            self.settle()

    def defer(self) -> None:
        """Queue writes without waiting for them, until ``settle``."""
        self._deferred = True

    def settle(self) -> None:
        """Wait until every write is done; BusError where one failed or takes too long."""
        self._deferred = False
        if not self._idle.wait(PATIENCE_S):
            raise BusError(
                sentence(
                    "the disk has not taken what is to be remembered of this bus for {patience_s:g} s; "
                    "look at it before anything is enabled",
                    patience_s=PATIENCE_S,
                )
            )
        if self._failed:
            raise self._failed.pop()

    def _work(self) -> None:
        while True:
            write, file, meaning = self._todo.get()
            try:
                write()
            except OSError as error:
                self._failed.append(unwritten(file, error, meaning))
            with self._lock:
                self._left -= 1
                if not self._left:
                    self._idle.set()
                    return
