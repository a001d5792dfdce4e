"""Identify and diagnose one recording, say what became of it, and keep that in the folder of results.

Each in a process of its own (``invid.processes``): a file that crashes a library, or for which memory lacks,
costs a row and not the batch.

``outcome.json`` is written last, so a recording whose folder has one is through. It names the recording's
checksum, the options and the software that made the documents, and counts only where all these are the same.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import tempfile
import threading
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from invid import __version__
from invid.api import diagnose, identify, read_recording
from invid.disk import not_written
from invid.errors import InputError, InvidError
from invid.identification.identify import Masses
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import csv_text, dump_json, model_to_json, save_text
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


# --- results ----------------------------------------------------------------------------------------
INDEX = "index.csv"
COLUMNS = ("recording", "status", "exit_status", "verdict", "headline", "error")
SUFFIXES = (".h5", ".hdf5", ".rows")
_DOCUMENTS = {"model": "model.json", "diagnosis": "diagnosis.json"}


def find_recordings(folder: Path, results: Path) -> dict[str, Path]:
    """Files that may be recordings below ``folder``, by their path below it; none of ``results``."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give the one below which the recordings lie")
    own = results.resolve()
    found = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.suffix in SUFFIXES and path.is_file() and own not in path.resolve().parents
    }
    if not found:
        raise InputError(f"{folder}: no recording ({', '.join(SUFFIXES)}) lies below it")
    return found


class Results:
    """The folder, locked against a second batch while it is used as a context."""

    def __init__(self, folder: Path, options: Options) -> None:
        self.folder, self.options = folder, options

    def __enter__(self) -> Results:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = (self.folder / ".lock").open("w")
        except OSError as error:
            raise not_written(self.folder, error) from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise InputError(f"{self.folder}: another batch writes there; give another folder") from None
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    def place(self, name: str) -> Path:
        """Where the documents of a recording go: its path without ``.h5``."""
        return self.folder / name.removesuffix(".h5")

    def kept(self, name: str, checksum: str) -> Outcome | None:
        """The outcome of an earlier batch, where it is final and would be the same again."""
        place = self.place(name)
        try:
            found = json.loads((place / "outcome.json").read_text(encoding="utf-8"))
            texts = {
                kind: (place / file).read_text(encoding="utf-8") if found["checksums"][kind] else ""
                for kind, file in _DOCUMENTS.items()
            }
            outcome = Outcome(**{c: found[c] for c in COLUMNS}, **texts)
        except (OSError, ValueError, KeyError, TypeError):
            return None
        same = found.get("made") == self._made(checksum, __version__) and found["checksums"] == _checksums(
            outcome
        )
        return outcome if same and outcome.final else None

    def store(self, outcome: Outcome, checksum: str) -> None:
        """Write the documents, then the outcome; nothing of an earlier one stays."""
        place = self.place(outcome.recording)
        try:
            for file in ("outcome.json", *_DOCUMENTS.values()):
                (place / file).unlink(missing_ok=True)
            for kind, file in _DOCUMENTS.items():
                if text := getattr(outcome, kind):
                    save_text(place / file, text)
        except OSError as error:
            raise not_written(place, error) from None
        document = {
            "format": "invid-batch-outcome",
            "format_version": 1,
            **row(outcome),
            "checksums": _checksums(outcome),
            "made": self._made(checksum, outcome.software),
        }
        save_text(place / "outcome.json", dump_json(document))

    def write_index(self, outcomes: Iterable[Outcome]) -> None:
        """``index.csv``: a row a recording, in the order of their names."""
        rows = [row(o).values() for o in sorted(outcomes, key=lambda o: o.recording)]
        save_text(self.folder / INDEX, csv_text(COLUMNS, rows))

    def _made(self, checksum: str, software: str) -> dict[str, Any]:
        options = json.loads(dump_json(asdict(self.options)))  # as it will be read
        return {"software": software, "recording_sha256": checksum, "options": options}


def checksum_of(path: Path) -> str:
    """SHA-256 of a file; "" where it cannot be read, which the analysis will say better."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


def row(outcome: Outcome) -> dict[str, Any]:
    """The row of the index, for JSON."""
    return {c: getattr(outcome, c) for c in COLUMNS}


def _checksums(outcome: Outcome) -> dict[str, str]:
    texts = {kind: getattr(outcome, kind) for kind in _DOCUMENTS}
    return {kind: hashlib.sha256(t.encode()).hexdigest() if t else "" for kind, t in texts.items()}
