"""Bodies of requests and answers about cells."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from invid.wording.fields import Text
from invid_service.jobs.schema import Identification, PersonName
from invid_service.jobs.states import State
from invid_service.spoken import Spoken


class Drive(BaseModel):
    """One drive of a cell."""

    axis: str
    node_id: int
    vendor: str
    rated_torque: float | None
    hold: str


class AxisLimits(BaseModel):
    """Limits of one axis."""

    axis: str
    torque: float
    position: float
    velocity: float
    torque_unit: str
    position_unit: str


class AcceptedModel(BaseModel):
    """The model in force."""

    id: str
    accepted: datetime
    by: str
    how: str
    """accept or restore; of an earlier release also auto."""


class LastRun(BaseModel):
    """The last run that came to a result or to its end."""

    id: str
    state: State
    ended: datetime | None
    verdict: str | None
    headline: Text | None
    grade: str | None


class Overview(BaseModel):
    """One line of a plant's list of cells; what a cell does now is at ``GET /state``."""

    last_run: LastRun | None
    news: Text | None
    """The first of what changed; empty where nothing did, ``null`` without a comparison."""


class CellView(Spoken):
    """A robot cell."""

    id: str
    name: str
    robot: str
    simulated: bool
    axes: list[str]
    bus: dict[str, Any]
    drives: list[Drive]
    limits: list[AxisLimits]
    model: AcceptedModel | None
    last_identification: Identification | None
    """The last measurement; a recording that was uploaded is none."""
    overview: Overview
    links: dict[str, str]


class CellList(BaseModel):
    """All cells of this service."""

    cells: list[CellView]
    simulated: bool


class StopAnswer(BaseModel):
    """Answer to a stop of one cell: what was moving."""

    cell: str
    stopping: bool
    """false: nothing was going on, or the run has ended: asked until then, a stop is confirmed by it."""
    moved: bool
    """The run had its drives enabled."""
    unknown: bool = False
    """The process of the last run was lost, and nobody saw its axes at rest: look."""
    identification: str | None
    simulated: bool
    note: str = "this stops motion through the drives' protocol; it is not a safety function"


class StopAnswers(BaseModel):
    """Answer to a stop of all cells: what was moving in each."""

    cells: list[StopAnswer]
    simulated: bool


class ModelEntry(BaseModel):
    """A model in the list of a cell."""

    id: str
    created: datetime
    mode: str
    in_force: bool
    accepted: list[AcceptedModel]


class ModelList(BaseModel):
    """Models of a cell, newest first; ``history`` is what was accepted or restored, newest first."""

    models: list[ModelEntry]
    history: list[AcceptedModel]
    simulated: bool


class RestoreBody(BaseModel):
    """Who takes an earlier model into force again."""

    model_config = ConfigDict(
        extra="forbid", strict=True, json_schema_extra={"examples": [{"by": "Ann Weld"}]}
    )
    by: PersonName | None = None
    """Default: the key's name."""


class Payload(BaseModel):
    """Mass added to the end of one axis."""

    model_config = ConfigDict(extra="forbid", strict=True)
    axis: str
    mass: float = Field(gt=-1e6, lt=1e6, allow_inf_nan=False)
    """[kg·m²], or [kg] on a linear axis; added to the final mass, negative takes away."""


class SimulationPatch(BaseModel):
    """A change of the simulated cell: another tool."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        json_schema_extra={"examples": [{"payload": {"axis": "A2", "mass": 1.31}}, {"reset": True}]},
    )
    reset: bool = False
    """First go back to what the config says."""
    payload: Payload | None = None


class SimulationView(BaseModel):
    """The simulated cell as it is now."""

    cell: str
    simulated: Literal[True] = True
    simulation: dict[str, Any]
