"""Messages between the service and its runner process: JSON lines over pipes.

Service → runner: the job, then ``Wish`` by ``Wish``; the end of the pipe means stop, so that a service that
dies takes its motion with it. Runner → service: ``Told``, one after the other; the last is an ``End``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

Wish = Literal["arm", "stop"]


class Job(BaseModel):
    """Everything a runner needs to know."""

    model_config = ConfigDict(extra="forbid")
    id: str
    kind: Literal["measure", "analyse"]
    mode: Literal["simulate", "test", "full", "screen", "upload"]
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
    simulator: str | None = None
    """Name of the file in ``folder`` that the recording is judged against."""
    memory_bytes: int
    stop_grace_s: float
    budget_s: float = 1500.0
    """Time for the analysis, after which the best answer so far is given: less than the half hour after which
    the service takes a run for hung."""


DISK_FULL_FIX = "make room on the disk of the service, then start again; what was measured is kept"


class ErrorInfo(BaseModel):
    """Why a run ended early: a stable code, a sentence, a way out."""

    model_config = ConfigDict(extra="allow")
    code: str
    text: str
    fix: str


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Planned(_Message):
    """What will move; without ``arm`` the runner waits for a person."""

    type: Literal["planned"] = "planned"
    plan: dict[str, Any]
    arm: bool = False


class Running(_Message):
    """The drives are about to be enabled."""

    type: Literal["running"] = "running"


class Known(BaseModel):
    """What the runs of a measurement that still moves tell so far."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    relative_std: float = Field(ge=0)
    """Of the mass, spring or coupling that is known worst."""
    shown: int = Field(ge=0)
    """Causes that would show at their size of interest."""
    asked: int = Field(ge=0)
    """Causes that are of interest."""


class Progress(_Message):
    """How far a run is."""

    type: Literal["progress"] = "progress"
    fraction: float = 0.0
    phase: str = ""
    axis: str | None = None
    frequency: float | None = None
    """[Hz]"""
    eta_s: float | None = None
    motion_left_s: float | None = None
    cause: str | None = None
    """What the analysis weighs."""
    most_s: float | None = None
    found: tuple[dict[str, Any], ...] = ()
    known: Known | None = None

    @property
    def place(self) -> tuple[float, str, str | None]:
        """Where it is: a run that goes on comes to another one."""
        return self.fraction, self.phase, self.axis

    def to_json(self) -> dict[str, Any]:
        """Return the members that the contract names."""
        document = self.model_dump(exclude={"type", "fraction"}, mode="json")
        return {"progress": self.fraction, **document}


class Measured(_Message):
    """The axes are at rest, and what was seen meanwhile."""

    type: Literal["measured"] = "measured"
    measurement: dict[str, Any] | None = None


class Read(_Message):
    """Whose recording is analysed."""

    type: Literal["recording"] = "recording"
    robot: str
    axes: tuple[str, ...]
    simulated: bool


class Done(_Message):
    """Everything is written into the folder of the job."""

    type: Literal["done"] = "done"
    summary: dict[str, Any] = {}


class EndedEarly(_Message):
    """Why a run ended without a result, and where its motion stood."""

    type: Literal["stopped", "failed"]
    error: ErrorInfo
    stopped: dict[str, Any] | None = None


End = Done | EndedEarly
Told = Planned | Running | Progress | Measured | Read | End
TOLD: TypeAdapter[Told] = TypeAdapter(Annotated[Told, Field(discriminator="type")])
