"""Routes of tunings: values for the drives from the model of a finished run; written into them by a person's
act alone.
"""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from invid.errors import InputError, InvidError
from invid.tuning.axis_loop import loops_from_json
from invid.tuning.motor_scale import MotorScale
from invid.wording.fields import Text
from invid_drivers.values.applying import Proposal, apply, propose, undo, written_entries
from invid_service.cells.registry import Cell
from invid_service.dependencies import Accepter, Context, Reader, RunInPath, Runner, find_run
from invid_service.jobs.files import artefact, file_responses
from invid_service.jobs.protocol import TuningTask
from invid_service.jobs.schema import RETRY_AFTER_S, PersonName, following
from invid_service.jobs.start import tuning_of
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, RETRY_AFTER, Problem, problem_responses
from invid_service.spoken import Spoken
from invid_service.store.blobs import KINDS

router = APIRouter(tags=["identifications"], responses=EVERYWHERE)


class TuningBody(BaseModel):
    """How to tune."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    cycle_s: float = Field(default=0.001, gt=0, le=0.1, description="Cycle of the drives' loops")
    notches: int = Field(default=2, ge=0, le=8, description="Notch filters, at most, of each axis")
    draws: int = Field(
        default=200, ge=50, le=5000, description="Machines of the covariance that keep margins"
    )
    drive: str | None = Field(
        default=None, max_length=40, pattern=r"^[a-z0-9_]+$", description="Also in this drive's own objects"
    )
    from_drives: bool = Field(default=False, description="Compare with what the cell's drives hold now")
    motors: dict[str, MotorScale] = Field(
        default_factory=dict,
        max_length=64,
        description="Gear and torque constant by axis; `drive` needs them",
    )


class ModelTuningBody(TuningBody):
    """Which model to tune on, and how."""

    model: str = Field(max_length=40, pattern=r"^[A-Za-z0-9-]+$", description="A run, or a model of a cell")


class ApplyBody(BaseModel):
    """A person's act: what was seen, and the robot's name."""

    model_config = ConfigDict(extra="forbid")
    token: str | None = Field(
        default=None, max_length=16, description="Of the list that was seen; without it nothing is written"
    )
    name: str | None = Field(default=None, max_length=200, description="The robot's name, typed by a person")
    by: PersonName | None = Field(default=None, description="Who agrees; default: the key's name")
    undo: bool = Field(default=False, description="Write back what the last act replaced")
    motors: dict[str, MotorScale] = Field(default_factory=dict, max_length=64)


class ObjectChange(BaseModel):
    """One object of one drive."""

    axis: str
    node_id: int
    object: str
    name: str
    unit: str
    old: float
    new: float


class Applied(Spoken):
    """What would be written, or was."""

    robot: str
    changes: list[ObjectChange]
    said: list[Text]
    """What the drives cannot hold, or what was left as it is and why."""
    token: str | None
    """Stands for this list; ``null`` once it is written."""
    written: int
    """Objects written, or written back."""
    can_undo: bool
    """Whether what an act replaced is remembered."""
    simulated: bool


class TuningState(BaseModel):
    """A tuning that goes on."""

    state: Literal["running"] = "running"
    simulated: bool


@router.post(
    "/identifications/{identification}/tuning",
    status_code=202,
    response_model=TuningState,
    responses={**ACCEPTED, **problem_responses(409, 410)},
)
async def start_tuning(
    response: Response,
    service: Context,
    caller: Runner,
    run: RunInPath,
    body: Annotated[TuningBody | None, Body()] = None,
) -> TuningState:
    """Work out gains, notch filters, feedforward and shapers from the model of this run, with the margins
    they leave over its covariance. It takes seconds; follow ``Location``. Nothing is written to a drive.
    """
    wanted, record = body or TuningBody(), run.record
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    found = [b for k in ("diagnosis", "model") if (b := blobs.get(k)) is not None]
    if blobs.get("model") is None:
        raise run.problem("wrong-state", " and has no model to tune on")
    cell = service.cells.get(record.cell or "")
    asks = wanted.from_drives and cell is not None and service.jobs.occupying(cell.id) is None
    task = TuningTask(
        **wanted.model_dump(include={"cycle_s", "notches", "draws", "drive"}),
        folder=service.blobs.work,
        source=service.blobs.path(found[0].path),
        simulated=record.simulated,
        motors=wanted.motors,
        config=cell.config.model_dump(mode="json") if asks and cell is not None else None,
    )
    service.tunings.start(record.id, task)
    response.headers.update(following(record.id, "tuning"))
    return TuningState(simulated=record.simulated)


@router.post(
    "/models/tune",
    status_code=202,
    response_model=TuningState,
    responses={**ACCEPTED, **problem_responses(409, 410)},
)
async def tune_model(
    body: ModelTuningBody, request: Request, response: Response, service: Context, caller: Runner
) -> TuningState:
    """Work out values for the drives from a model, which has the id of its run."""
    run = await find_run(body.model, request, service)
    return await start_tuning(response, service, caller, run, body)


_ANSWERS: dict[int | str, dict[str, Any]] = {
    **file_responses(KINDS["tuning"][1]),
    **problem_responses(409, 410),
    202: {"description": "It goes on", "model": TuningState, "headers": RETRY_AFTER},
}


@router.get("/identifications/{identification}/tuning", response_class=Response, responses=_ANSWERS)
async def get_tuning(request: Request, service: Context, _caller: Reader, run: RunInPath) -> Response:
    """Return the values for the drives, before and after, with their margins and what repair would buy."""
    record = run.record
    if service.tunings.is_running(record.id):
        state = TuningState(simulated=record.simulated).model_dump_json()
        return Response(state, 202, {"Retry-After": str(RETRY_AFTER_S)}, "application/json")
    why = service.tunings.failure(record.id)
    if why is not None:
        raise Problem("not-tunable", why, simulated=record.simulated)
    return await artefact(service, run, "tuning", request)


@router.get("/models/tune/{model}", response_class=Response, responses=_ANSWERS)
async def get_model_tuning(model: str, request: Request, service: Context, caller: Reader) -> Response:
    """Return what was worked out for this model."""
    return await get_tuning(request, service, caller, await find_run(model, request, service))


@router.post("/models/tune/{model}/apply", response_model=Applied, responses=problem_responses(409))
async def apply_tuning(
    model: str, body: ApplyBody, request: Request, service: Context, caller: Accepter
) -> Applied:
    """Write these values into the drives of the cell, by a person's act.

    Without ``token`` the drives are asked and nothing is written: the answer lists every object, old and
    new, with a ``token`` for the list. With it, and with the robot's name, what changes is written into
    drives that are off or stand, and read back; where one is not taken, or holds another value than the list
    says, nothing stays written. ``undo`` writes back what the last act replaced.
    """
    record = (await find_run(model, request, service)).record
    cell = service.cell(record.cell or "")
    if (body.token is not None or body.undo) and body.name != cell.config.robot:
        raise Problem(
            "not-applied",
            f"not confirmed: the robot is called {cell.config.robot!r}; nothing was written",
            simulated=cell.simulated,
        )
    async with service.start_locks[cell.id]:
        service.require_free_bus(cell)
        writes = body.undo or body.token is not None
        if writes:
            facts = {"cell": cell.id, "model": record.id, "by": body.by or caller.name, "undo": body.undo}
            await asyncio.to_thread(service.audit.write, "apply", caller=caller.name, **facts)
        document = None if body.undo else await tuning_of(service, record.id, cell)
        try:
            return await asyncio.to_thread(_act, cell, body, document)
        except InvidError as error:
            raise Problem("not-applied", str(error), simulated=cell.simulated) from None


def _act(cell: Cell, body: ApplyBody, document: dict[str, Any] | None) -> Applied:
    config = cell.config
    if document is None:
        written, said = undo(config, lambda entries: None)
        return _answer(cell, Proposal((), said), written, told=False)
    loops = loops_from_json(document, "tuning.json")
    if body.token is None:
        return _answer(cell, propose(config, loops, body.motors), 0, told=True)

    def agree(proposal: Proposal) -> None:
        if proposal.token != body.token:
            raise InputError(
                "the drives hold other values than those of the list that was agreed to; look at it again"
            )

    done = apply(config, loops, body.motors, agree)
    return _answer(cell, done, len(done.changes), told=False)


def _answer(cell: Cell, proposal: Proposal, written: int, *, told: bool) -> Applied:
    document = proposal.to_json()
    return Applied(
        robot=cell.config.robot,
        changes=document["changes"],
        said=document["said"],
        token=document["token"] if told else None,
        written=written,
        can_undo=bool(written_entries(cell.config)),
        simulated=cell.simulated,
    )
