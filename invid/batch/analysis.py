"""Identify and diagnose one recording in a process of its own, and say what became of it.

A file that crashes a library, or for which memory lacks, then costs a row and not the batch. The process goes
on with the next recording, and ends when whoever asked is gone. (One of ``multiprocessing`` may not be
started by a Dask worker.)
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from invid import __version__
from invid.api import diagnose, identify, read_recording
from invid.errors import InvidError
from invid.identification.identify import Masses
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import dump_json, model_to_json

KILLED = ""
"""Exit status where there is none: the process was killed."""
INTERNAL = 70
"""Exit status of an error of ours, as of the commands."""


@dataclass(frozen=True)
class Options:
    """What decides on the documents: ``masses`` as of ``invid.identify``; ``budget`` [s] for both steps."""

    masses: Masses = None
    budget: float | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one recording: its row of the index and its documents.

    ``status`` "done" or "failed"; ``exit_status`` as of ``invid diagnose``, "" where the process was killed;
    ``model`` and ``diagnosis`` JSON text, "" where there is none.
    """

    recording: str
    status: str
    exit_status: int | str
    verdict: str = ""
    headline: str = ""
    error: str = ""
    model: str = ""
    diagnosis: str = ""
    software: str = __version__

    @classmethod
    def failed(cls, name: str, exit_status: int | str, error: str) -> Outcome:
        """The outcome of a recording without documents; ``error`` is brought into one line."""
        return cls(name, "failed", exit_status, error=" ".join(error.split()))

    @property
    def final(self) -> bool:
        """False where another attempt may end otherwise: the process was killed, or the error was ours."""
        return self.exit_status not in (KILLED, INTERNAL)


def analyse_recording(path: Path, name: str, options: Options) -> Outcome:
    """Identify and diagnose the recording in ``path``, called ``name`` in all that is said of it."""
    began = time.monotonic()
    try:
        recording = replace(read_recording(path), source=name)
        model = identify(recording, masses=options.masses, budget=options.budget)
        left = None if options.budget is None else max(options.budget - (time.monotonic() - began), 0.1)
        diagnosis = diagnose(recording, model=model, budget=left)
    except InvidError as error:
        return Outcome.failed(name, error.exit_code, str(error).replace(str(path), name))
    except Exception as error:  # listed like any other: one recording stops no batch
        said = f"internal error, please report it: {type(error).__name__}: {error}"
        return Outcome.failed(name, INTERNAL, said)
    return Outcome(
        name,
        "done",
        0 if diagnosis.model.fit.get("trustworthy", True) else 3,
        verdict=str(diagnosis.verdict),
        headline=" ".join(diagnosis.headline.split()),
        model=dump_json(model_to_json(model)),
        diagnosis=dump_json(diagnosis_to_json(diagnosis)),
    )


ATTEMPTS = 2
"""Of a recording whose process dies: once may have been the system's doing, twice is the recording's."""
_ANSWER = f"import sys; from {__name__} import answer; answer(int(sys.argv[1]))"


class Helper:
    """Process that analyses recordings, started when it is first asked and again after it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def ask(self, path: Path, name: str, options: Options) -> Outcome:
        """The outcome of a recording; where the process died on every attempt, one that says so."""
        how = "before it began"
        for _ in range(0 if self._closed else ATTEMPTS):
            if self._process is None:
                self._start()
            try:
                self._answers.send((path, name, options))
                outcome: Outcome = self._answers.recv()
            except (OSError, EOFError):
                how = self._died()
            else:
                return outcome
        said = f"its process ended {how} on {ATTEMPTS} attempts (is there memory enough? try fewer --workers)"
        return Outcome.failed(name, KILLED, said)

    def _start(self) -> None:
        self._answers, theirs = Pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _ANSWER, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the one who asks
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        theirs.close()
        if self._closed:  # meanwhile
            self._process.kill()

    def _died(self) -> str:
        self._answers.close()
        status = 0 if self._process is None else self._process.wait()
        self._process = None
        return f"by signal {-status}" if status < 0 else f"with status {status}"

    def close(self) -> None:
        """End the process, in the middle of a recording too."""
        self._closed = True
        if self._process is not None:
            self._process.kill()


_own = threading.local()


def own_helper() -> Helper:
    """The helper of the calling thread."""
    if not hasattr(_own, "helper"):
        _own.helper = Helper()
    helper: Helper = _own.helper
    return helper


def analyse_content(content: bytes, name: str, options: Options) -> Outcome:
    """An outcome from the bytes of a recording: what a cluster's worker runs, with no file system shared."""
    with tempfile.TemporaryDirectory(prefix="invid-batch-") as folder:
        path = Path(folder) / f"recording{Path(name).suffix}"
        path.write_bytes(content)
        return own_helper().ask(path, name, options)


def answer(number: int) -> None:
    """Answer tasks from the connection of a file descriptor until whoever asks is gone."""
    asker = Connection(number)
    tasks: queue.SimpleQueue[tuple[Path, str, Options]] = queue.SimpleQueue()

    def listen() -> None:
        with suppress(EOFError, OSError):
            while True:
                tasks.put(asker.recv())
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        asker.send(analyse_recording(*tasks.get()))
