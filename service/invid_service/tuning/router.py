"""Routes of tunings: values for the drives from the model of a finished run; nothing is written to a
drive."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Body, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from invid.tuning.motor_scale import MotorScale
from invid_service.auth import Reader, Runner
from invid_service.context import Context
from invid_service.jobs.router import artefact, file_responses
from invid_service.jobs.schema import RETRY_AFTER_S
from invid_service.links import address
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, RETRY_AFTER, Problem, problem_responses
from invid_service.store.blobs import KINDS
from invid_service.tuning.order import Order

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
    "/identifications/{identification}/tuning",
    status_code=202,
    response_model=TuningState,
    responses={**ACCEPTED, **problem_responses(409, 410)},
)
async def start_tuning(
    identification: str,
    response: Response,
    service: Context,
    caller: Runner,
    body: Annotated[TuningBody | None, Body()] = None,
) -> TuningState:
    """Work out gains, notch filters, feedforward and shapers from the model of this run, with the margins
    they leave over its covariance. It takes seconds; follow ``Location``. Nothing is written to a drive.
    """
    record, _ = await service.run(identification)
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    found = {k: b for k in ("diagnosis", "model") if (b := blobs.get(k)) is not None}
    if "model" not in found:
        raise Problem(
            "wrong-state",
            f"identification {record.id} is {record.state} and has no model to tune on",
            state=str(record.state),
            simulated=record.simulated,
        )
    wanted = body or TuningBody()
    order = Order(
        folder=service.blobs.work,
        source=service.blobs.path(next(iter(found.values())).path),
        simulated=record.simulated,
        cycle_s=wanted.cycle_s,
        notches=wanted.notches,
        draws=wanted.draws,
        drive=wanted.drive,
        motors=wanted.motors,
    )
    service.tunings.start(record.id, order)
    response.headers["Location"] = address("identifications", record.id, "tuning")
    response.headers["Retry-After"] = str(RETRY_AFTER_S)
    return TuningState(simulated=record.simulated)


@router.get(
    "/identifications/{identification}/tuning",
    response_class=Response,
    responses={
        **file_responses(KINDS["tuning"][1]),
        **problem_responses(409, 410),
        202: {"description": "It goes on", "model": TuningState, "headers": RETRY_AFTER},
    },
)
async def get_tuning(identification: str, request: Request, service: Context, _caller: Reader) -> Response:
    """Return the values for the drives, before and after, with their margins and what repair would buy."""
    record, _ = await service.run(identification)
    if service.tunings.is_running(record.id):
        state = TuningState(simulated=record.simulated).model_dump_json()
        return Response(state, 202, {"Retry-After": str(RETRY_AFTER_S)}, "application/json")
    why = service.tunings.failure(record.id)
    if why is not None:
        raise Problem("not-tunable", why, simulated=record.simulated)
    return await artefact(service, identification, "tuning", request)
