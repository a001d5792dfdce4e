"""``GET /cells/{cell}/state``: what a PLC polls, small enough for its buffer."""

from __future__ import annotations

import asyncio
from datetime import datetime

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

from invid_service.auth import Reader
from invid_service.cells.registry import Cell
from invid_service.context import Context
from invid_service.jobs.live import LiveRun
from invid_service.jobs.schema import polling_headers
from invid_service.jobs.states import IDLE, State
from invid_service.problems import EVERYWHERE, RETRY_AFTER
from invid_service.service import Service

router = APIRouter(tags=["cells"], responses=EVERYWHERE)
_PHASE = 60
"""Characters of a phase: it may name an effect that somebody else wrote."""


class CellNow(BaseModel):
    """The last measurement of a cell, in progress or ended, in less than 1 kB."""

    cell: str
    state: str
    """Of ``run``, as there; ``idle`` where the cell was never measured."""
    run: str | None = None
    since: datetime | None = None
    """When it came into this state."""
    phase: str = Field(default="", max_length=_PHASE)
    progress: float = Field(default=0.0, ge=0, le=1)
    eta_s: float | None = None
    """As of the run [s]."""
    motion_left_s: float | None = None
    """As of the run [s]."""
    error: str | None = None
    """The code of why it ended early."""
    grade: str | None = None
    """Of its result: ``as_expected``, ``watch`` or ``act``."""
    simulated: bool


@router.get(
    "/cells/{cell}/state",
    response_model=CellNow,
    responses={200: {"description": "As it is now", "headers": RETRY_AFTER}},
)
async def get_cell_state(cell: str, service: Context, _caller: Reader) -> Response:
    """State of the cell's last measurement: which run, how far, since when. Less than 1 kB, made for a PLC
    that asks every second.
    """
    found = service.cell(cell)
    run = await _last_run(service, found)
    now = CellNow(cell=found.id, state=IDLE, simulated=found.simulated) if run is None else _now(found, run)
    headers = {} if run is None else polling_headers(run.record)
    return Response(now.model_dump_json(), media_type="application/json", headers=headers)


async def _last_run(service: Service, cell: Cell) -> LiveRun | None:
    """From memory while one goes on: a store that hangs keeps nobody from seeing that the robot moves."""
    occupying = service.jobs.occupying(cell.id)
    if occupying is not None:
        return occupying
    for record in await asyncio.to_thread(service.store.runs, cell=cell.id, limit=1, measured=True):
        return service.jobs.live(record.id) or LiveRun(record)
    return None


def _now(cell: Cell, run: LiveRun) -> CellNow:
    facts, progress = run.record.facts, run.progress
    done = run.record.state in (State.SUCCEEDED, State.AWAITING_ACCEPT)
    return CellNow(
        cell=cell.id,
        state=run.record.state,
        run=run.record.id,
        since=run.since,
        phase=progress.phase[:_PHASE],
        progress=1.0 if done else progress.fraction or facts.get("progress", 0.0),
        eta_s=None if progress.eta_s is None else round(progress.eta_s, 1),
        motion_left_s=None if progress.motion_left_s is None else round(progress.motion_left_s, 1),
        error=(facts.get("error") or {}).get("code"),
        grade=(facts.get("summary") or {}).get("grade"),
        simulated=run.record.simulated,
    )
