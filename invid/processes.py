"""Calls worked out in a process of their own: its crash, or memory that lacks, costs an answer and no more.

(A process of ``multiprocessing`` may not be started by a Dask worker.)
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from signal import Signals
from typing import Any

_ANSWER = f"import sys; from {__name__} import answer; answer(int(sys.argv[1]))"


class ProcessEnded(RuntimeError):
    """The process ended before it answered: with ``status``, below 0 the signal; ``said`` its last line."""

    def __init__(self, status: int, said: str) -> None:
        super().__init__(f"by {Signals(-status).name}" if status < 0 else f"with status {status}")
        self.status, self.said = status, said


class Helper:
    """Process that answers calls, started when it is first asked and again after it ended.

    It ends in the middle of an answer when whoever asked is gone.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def call(self, function: Callable[..., Any], *arguments: Any, timeout: float | None = None) -> Any:
        """What a function of a module returns or raises there.

        Raises
        ------
        ProcessEnded
            The process ended before it answered.
        TimeoutError
            It has not answered in so many seconds, and was ended.
        """
        if self._process is None:
            self._start()
        try:
            self._answers.send((function, arguments))
            is_late = not self._answers.poll(timeout)
            error, answered = (None, None) if is_late else self._answers.recv()
        except (OSError, EOFError):
            raise self._ended() from None
        if is_late:
            self._kill()
            self._ended()
            raise TimeoutError
        if error is not None:
            raise error
        return answered

    def _start(self) -> None:
        self._answers, theirs = Pipe()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the helper
        self._process = subprocess.Popen(
            [sys.executable, "-c", _ANSWER, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            start_new_session=True,  # Ctrl-C is for the one who asks
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        if self._closed:  # meanwhile
            self._kill()

    def _ended(self) -> ProcessEnded:
        """How the process ended; the next call starts another."""
        self._answers.close()
        status = 0 if self._process is None else self._process.wait()
        self._process = None
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").split("\n")
        return ProcessEnded(status, next((line for line in reversed(lines) if line.strip()), ""))

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """End the process, in the middle of an answer too."""
        self._closed = True
        self._kill()


def answer(number: int) -> None:
    """Answer calls from the connection of a file descriptor until whoever asks is gone."""
    asker = Connection(number)
    calls: queue.SimpleQueue[tuple[Callable[..., Any], tuple[Any, ...]]] = queue.SimpleQueue()

    def listen() -> None:
        with suppress(EOFError, OSError):
            while True:
                calls.put(asker.recv())
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        function, arguments = calls.get()
        try:
            asker.send((None, function(*arguments)))
        except Exception as error:  # for the one who asked
            asker.send((error, None))
