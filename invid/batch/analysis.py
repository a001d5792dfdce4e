"""Identify and diagnose one recording, and say what became of it.

Each in a process of its own (``invid.processes``): a file that crashes a library, or for which memory lacks,
costs a row and not the batch.
"""

from __future__ import annotations

import tempfile
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from invid import __version__
from invid.api import diagnose, identify, read_recording
from invid.errors import InvidError
from invid.identification.identify import Masses
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import dump_json, model_to_json
from invid.processes import Helper, ProcessEnded

KILLED = ""
"""Exit status where there is none: the process was killed."""
INTERNAL = 70
"""Exit status of an error of ours, as of the commands."""
ATTEMPTS = 2
"""Of a recording whose process dies: once may have been the system's doing, twice is the recording's."""


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


def analyse_apart(helper: Helper, path: Path, name: str, options: Options) -> Outcome:
    """``analyse_recording`` in the helper's process; where that ended on every attempt, it is said."""
    how = ""
    for _ in range(ATTEMPTS):
        try:
            outcome: Outcome = helper.call(analyse_recording, path, name, options)
        except ProcessEnded as ended:
            how = str(ended)
        else:
            return outcome
    said = f"its process ended {how} on {ATTEMPTS} attempts (is there memory enough? try fewer --workers)"
    return Outcome.failed(name, KILLED, said)


_own = threading.local()


def analyse_content(content: bytes, name: str, options: Options) -> Outcome:
    """An outcome from the bytes of a recording: what a cluster's worker runs, with no file system shared."""
    if not hasattr(_own, "helper"):
        _own.helper = Helper()
    with tempfile.TemporaryDirectory(prefix="invid-batch-") as folder:
        path = Path(folder) / f"recording{Path(name).suffix}"
        path.write_bytes(content)
        return analyse_apart(_own.helper, path, name, options)
