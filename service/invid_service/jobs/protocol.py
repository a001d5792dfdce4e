"""The tasks of runners, and what is said between them and the service (see ``invid_drivers.protocol``)."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from invid.tuning.motor_scale import MotorScale
from invid.wording.fields import Text
from invid.wording.sentence import Sentence, as_sentences, with_wording
from invid_drivers.protocol import AxisStates, Done, LastSeen, Line


@dataclass(frozen=True)
class Arm:
    """Move."""


@dataclass(frozen=True)
class Planned:
    """What will move; without ``arm`` the runner waits for a person."""

    plan: dict[str, Any]
    arm: bool = False


@dataclass(frozen=True)
class Running:
    """The drives are about to be enabled."""


class Known(BaseModel):
    """What the runs of a measurement that still moves tell so far."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    relative_std: float = Field(ge=0)
    """Of the mass, spring or coupling that is known worst."""
    shown: int = Field(ge=0)
    """Causes that would show at their size of interest."""
    asked: int = Field(ge=0)
    """Causes that are of interest."""


class FoundCause(BaseModel):
    """A cause found while the analysis still looks."""

    cause: str
    axis: str
    other_axis: str | None
    element: str | None


class RunProgress(BaseModel):
    """How far a run is."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)
    progress: float = Field(default=0.0, ge=0, le=1)
    phase: Text = ""
    axis: str | None = None
    frequency: float | None = None
    """[Hz]"""
    eta_s: float | None = None
    """Until the result, as the last runs took, in the analysis of a first one as its own stages took [s];
    ``null`` where that is not known: it is the first and moves yet, or it takes longer than they did."""
    most_s: float | None = None
    """Until the analysis ends at the latest, with its best answer so far [s]."""
    motion_left_s: float | None = None
    """Until the axes are at rest, by the plan; ``null`` where nothing moves [s]."""
    cause: str | None = None
    """What the analysis weighs now; its axis is ``axis``."""
    found: list[FoundCause] = []
    """What the analysis found so far; it still looks."""
    known: Known | None = None
    """What the runs so far tell, while the next one moves: the measurement ends when that is enough."""

    @property
    def place(self) -> tuple[float, str, str | None]:
        """Where it is: a run that goes on comes to another one."""
        return self.progress, self.phase, self.axis


@dataclass(frozen=True)
class Measured:
    """The axes are at rest, and what was seen meanwhile."""

    measurement: dict[str, Any] | None = None


@dataclass(frozen=True)
class Read:
    """Whose recording is analysed."""

    robot: str
    axes: tuple[str, ...]
    simulated: bool


class ErrorInfo(BaseModel):
    """Why a run ended early: a stable code, a sentence, a way out."""

    model_config = ConfigDict(extra="allow", frozen=True)
    code: str
    text: Text
    what: Text = ""
    """What kind of end it is, in general; empty where ``text`` says it."""
    fix: Text
    axes: list[LastSeen] | None = None
    """Of a run whose axes nobody saw at rest: what each was seen to be last."""
    known: list[Text] | None = None
    """What else is known of them."""


@dataclass(frozen=True)
class EndedEarly:
    """Why a run ended without a result, and where its motion stood."""

    type: Literal["stopped", "failed"]
    error: ErrorInfo
    stopped: dict[str, Any] | None = None


End = Done | EndedEarly
Told = Planned | Running | RunProgress | AxisStates | Measured | Read | End


@dataclass(frozen=True, kw_only=True)
class Job:
    """Everything a runner needs to know."""

    id: str
    kind: Literal["measure", "analyse"]
    mode: Literal["simulate", "test", "full", "screen", "verify", "upload"]
    requested_by: str
    """Who started it; named in the report."""
    folder: Path
    """Where results are written: ``recording.h5``, ``model.json``, …"""
    simulated: bool
    config: dict[str, Any] | None = None
    axes: list[str] | None = None
    amplitude_scale: float = 1.0
    amplitude: Literal["planned", "gentler"] = "planned"
    purpose: str | None = None
    """What the experiments are for, where they are not the cell's own; told in the plan."""
    expected_analysis_s: float | None = None
    """How long the analysis took before on this cell."""
    arm: bool = False
    acceptable: bool = True
    """False where the result says nothing new of the cell: a real cell simulated with its own model."""
    model: dict[str, Any] | None = None
    """The accepted model: for the forecast of travel, for ``mode`` "simulate" on a real cell, and for the
    plan of ``mode`` "screen"."""
    tuning: dict[str, Any] | None = None
    """The tuning whose loops ``mode`` "verify" measures."""
    memory_bytes: int
    stop_grace_s: float
    budget_s: float = 1500.0
    """Time for the analysis, after which the best answer so far is given: less than the half hour after which
    the service takes a run for hung."""


@dataclass(frozen=True, kw_only=True)
class TuningTask:
    """What the process that tunes needs to know."""

    folder: Path
    source: Path
    simulated: bool
    cycle_s: float
    notches: int
    draws: int
    drive: str | None
    motors: Mapping[str, MotorScale]


class Stopped(Exception):
    """Raised in a process that works where somebody asked for the end."""


class RunnerLine(Line):
    """The end of a runner: it may be armed."""

    def __init__(self, connection: Connection, *, silence_s: float | None = None) -> None:
        super().__init__(connection, silence_s=silence_s)
        self.armed = threading.Event()

    def hear(self, message: Any) -> None:
        """Take in what the service wishes beside a stop; nothing but ``Arm`` moves anything."""
        if isinstance(message, Arm):
            self.armed.set()

    def check_stop(self) -> None:
        """Raise ``Stopped`` where the end was asked for."""
        if self.stop.is_set():
            raise Stopped


def plain(document: Mapping[str, Any]) -> Any:
    """Return the document as JSON has it, its sentences kept."""
    return as_sentences(json.loads(json.dumps(with_wording(document), default=float)))


def without_folder(text: str, folder: Path) -> str:
    """Return a text or sentence that does not say where a file lies."""
    if isinstance(text, Sentence):
        values = {name: without_folder(value, folder) for name, value in text.values.items()}
        return Sentence(text.template, values, text.form)
    return text.replace(f"{folder}/", "").replace(f" in {folder}", "") if str(folder) in text else text
