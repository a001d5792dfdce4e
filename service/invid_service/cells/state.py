"""What every cell does, in one small answer from memory: a poll waits for no store and no drive."""

from __future__ import annotations

import asyncio
import hashlib
from datetime import datetime

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from invid_service.auth import Reader
from invid_service.cells.registry import Cell
from invid_service.context import Context
from invid_service.jobs.states import OCCUPYING, State
from invid_service.problems import EVERYWHERE
from invid_service.service import Service

router = APIRouter(tags=["cells"], responses=EVERYWHERE)
_GOING_ON = OCCUPYING | {State.AWAITING_ACCEPT}


class CellState(BaseModel):
    """One cell now."""

    cell: str
    name: str
    simulated: bool
    state: str
    """Of the run in progress, or ``awaiting_accept``; else ``ready``, ``not_ready`` (see readiness), or
    ``unknown`` while drives or store have not said."""
    moves: bool = False
    """A run has its drives enabled."""
    run: str | None = None
    """The last measurement that was started, in progress or ended."""
    run_state: State | None = None
    since: datetime | None = None
    """When the run came into ``run_state``."""
    progress: float = Field(default=0.0, ge=0, le=1)
    phase: str | None = None
    axis: str | None = None
    frequency: float | None = None
    """[Hz]"""
    cause: str | None = None
    eta_s: float | None = None
    """As of the run [s]."""
    motion_left_s: float | None = None
    """Until the axes are at rest [s]."""
    grade: str | None = None
    """Of the run's result."""


class CellStates(BaseModel):
    """All cells."""

    cells: list[CellState]
    simulated: bool


@router.get(
    "/state",
    response_model=CellStates,
    responses={304: {"description": "Not changed since the ETag given in If-None-Match"}},
)
async def all_states(request: Request, service: Context, _caller: Reader) -> Response:
    """What every cell does, made to be asked every second: 0.4 kB a cell, with an `ETag`."""
    cells = await asyncio.gather(*(state_of(service, cell) for cell in service.cells.values()))
    body = CellStates(cells=cells, simulated=any(c.simulated for c in cells)).model_dump_json()
    headers = {"ETag": f'"{hashlib.sha256(body.encode()).hexdigest()[:16]}"', "Cache-Control": "no-cache"}
    if headers["ETag"] in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type="application/json", headers=headers)


async def state_of(service: Service, cell: Cell) -> CellState:
    """The cell now, from memory."""
    run = service.jobs.latest(cell.id)
    if run is not None and run.record.state in _GOING_ON:
        state = str(run.record.state)
    else:
        can_start = await service.can_start.of(cell.id, lambda: service.readiness(cell))
        state = "unknown" if can_start is None else "ready" if can_start else "not_ready"
    common = {"cell": cell.id, "name": cell.config.robot, "simulated": cell.simulated, "state": state}
    if run is None:
        return CellState(**common)
    return CellState(
        **common,
        moves=run.record.state is State.RUNNING,
        run=run.record.id,
        run_state=run.record.state,
        since=run.since,
        grade=(run.record.facts.get("summary") or {}).get("grade"),
        **run.progress.to_json(),
    )
