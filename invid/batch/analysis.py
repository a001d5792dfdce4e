"""Identify and diagnose one recording, and say what became of it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from invid.api import diagnose, identify, read_recording
from invid.errors import InvidError
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import dump_json, model_to_json

KILLED = ""
"""Exit status where there is none: the process was killed."""
INTERNAL = 70
"""Exit status of an error of ours, as of the commands."""


@dataclass(frozen=True)
class Options:
    """What decides on the documents: ``masses`` as of ``invid.identify``; ``budget`` [s] for both steps."""

    masses: tuple[int, ...] | str | None = None
    budget: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain values, for tasks and for the record of what was done."""
        masses = list(self.masses) if isinstance(self.masses, tuple) else self.masses
        return {"masses": masses, "budget": self.budget}

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> Options:
        """Return the outcome that ``to_json`` made plain."""
        masses = document["masses"]
        return cls(tuple(masses) if isinstance(masses, list) else masses, document["budget"])


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

    @property
    def final(self) -> bool:
        """False where another attempt may end otherwise: the process was killed, or the error was ours."""
        return self.exit_status not in (KILLED, INTERNAL)


def analyse_recording(path: Path, name: str, options: Options) -> Outcome:
    """Identify and diagnose the recording in ``path``, called ``name`` in all that is said of it."""
    began = time.monotonic()
    try:
        recording = replace(read_recording(path), source=name)
        model = identify(recording, masses=options.masses, budget=options.budget)  # type: ignore[arg-type]
        left = None if options.budget is None else max(options.budget - (time.monotonic() - began), 0.1)
        diagnosis = diagnose(recording, model=model, budget=left)
    except InvidError as error:
        text = " ".join(str(error).replace(str(path), name).split())
        return Outcome(name, "failed", error.exit_code, error=text)
    except Exception as error:  # listed like any other: one recording stops no batch
        text = " ".join(f"internal error, please report it: {type(error).__name__}: {error}".split())
        return Outcome(name, "failed", INTERNAL, error=text)
    return Outcome(
        name,
        "done",
        0 if diagnosis.model.fit.get("trustworthy", True) else 3,
        verdict=str(diagnosis.verdict),
        headline=" ".join(diagnosis.headline.split()),
        model=dump_json(model_to_json(model)),
        diagnosis=dump_json(diagnosis_to_json(diagnosis)),
    )
