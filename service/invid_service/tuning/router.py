"""Routes of tunings: values for the drives from the model of a finished run."""

from __future__ import annotations

import asyncio
from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from invid.tuning.motor_scale import MotorScale
from invid_service.dependencies import Context, Reader, RunInPath, Runner, find_run
from invid_service.jobs.files import artefact, file_responses
from invid_service.jobs.protocol import TuningTask
from invid_service.jobs.schema import RETRY_AFTER_S, following
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, RETRY_AFTER, Problem, problem_responses
from invid_service.store.blobs import KINDS

router = APIRouter(tags=["identifications"], responses=EVERYWHERE)


class TuningBody(BaseModel):
    """Which model to tune on, and how."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    model: str = Field(max_length=40, pattern=r"^[A-Za-z0-9-]+$", description="A run, or a model of a cell")
    cycle_s: float = Field(default=0.001, gt=0, le=0.1, description="Cycle of the drives' loops")
    notches: int = Field(default=2, ge=0, le=8, description="Notch filters, at most, of each axis")
    draws: int = Field(
        default=200, ge=50, le=5000, description="Machines of the covariance that keep margins"
    )
    drive: str | None = Field(
        default=None, max_length=40, pattern=r"^[a-z0-9_]+$", description="Also in this drive's own objects"
    )
    motors: dict[str, MotorScale] = Field(
        default_factory=dict,
        max_length=64,
        description="Gear and torque constant by axis; `drive` needs them",
    )


class TuningState(BaseModel):
    """A tuning that goes on."""

    state: Literal["running"] = "running"
    simulated: bool


@router.post(
    "/models/tune",
    status_code=202,
    response_model=TuningState,
    responses={**ACCEPTED, **problem_responses(409, 410)},
)
async def tune_model(
    body: TuningBody, request: Request, response: Response, service: Context, _caller: Runner
) -> TuningState:
    """Work out gains, notch filters, feedforward and shapers from a model, which has the id of its run, with
    the margins they leave over its covariance. It takes seconds; follow ``Location``. Nothing is written to a
    drive.
    """
    run = await find_run(body.model, request, service)
    record = run.record
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    found = [b for k in ("diagnosis", "model") if (b := blobs.get(k)) is not None]
    if blobs.get("model") is None:
        raise run.problem("wrong-state", " and has no model to tune on")
    task = TuningTask(
        **body.model_dump(include={"cycle_s", "notches", "draws", "drive"}),
        folder=service.blobs.work,
        source=service.blobs.path(found[0].path),
        simulated=record.simulated,
        motors=body.motors,
    )
    service.tunings.start(record.id, task)
    response.headers.update(following(record.id, "tuning"))
    return TuningState(simulated=record.simulated)


_ANSWERS: dict[int | str, dict[str, Any]] = {
    **file_responses(KINDS["tuning"][1]),
    **problem_responses(409, 410),
    202: {"description": "It goes on", "model": TuningState, "headers": RETRY_AFTER},
}


@router.get("/identifications/{identification}/tuning", response_class=Response, responses=_ANSWERS)
async def get_tuning(request: Request, service: Context, _caller: Reader, run: RunInPath) -> Response:
    """Return the values for the drives, before and after, with their margins."""
    record = run.record
    if service.tunings.is_running(record.id):
        state = TuningState(simulated=record.simulated).model_dump_json()
        return Response(state, 202, {"Retry-After": str(RETRY_AFTER_S)}, "application/json")
    why = service.tunings.failure(record.id)
    if why is not None:
        raise Problem("not-tunable", why, simulated=record.simulated)
    return await artefact(service, run, "tuning", request)
