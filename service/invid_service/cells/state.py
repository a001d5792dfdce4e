"""Answer what a cell does in one small body from memory: a poll waits for no store and no drive.

``GET /cells/{cell}/state`` is small enough for a PLC's buffer; ``GET /state`` says more, of all cells at
once, for the page.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import datetime
from textwrap import shorten
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from invid.wording.fields import Text
from invid_service.cells.registry import Cell
from invid_service.cells.schema import LastRun, Overview
from invid_service.dependencies import CellInPath, Context, Reader
from invid_service.jobs.protocol import RunProgress
from invid_service.jobs.schema import polling_headers
from invid_service.jobs.states import ENDED, IDLE, OCCUPYING, State
from invid_service.problems import EVERYWHERE, RETRY_AFTER
from invid_service.service import Service
from invid_service.spoken import Spoken
from invid_service.store.store import RunRecord

router = APIRouter(tags=["cells"], responses=EVERYWHERE)
_GOING_ON = OCCUPYING | {State.AWAITING_ACCEPT}
_NEWS = {"appeared", "grew", "shrank", "gone", "changed"}
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
    phase: Annotated[Text, Field(max_length=_PHASE)] = ""
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


class CellState(CellNow, RunProgress):
    """One cell now, as the page draws it."""

    name: str
    status: str
    """Of the run in progress, or ``awaiting_accept``; else ``ready``, ``not_ready`` (see readiness), or
    ``unknown`` while drives or store have not said."""
    moves: bool = False
    """A run has its drives enabled."""


class CellStates(Spoken):
    """States of all cells."""

    cells: list[CellState]
    simulated: bool


@router.get(
    "/cells/{cell}/state",
    response_model=CellNow,
    responses={200: {"description": "As it is now", "headers": RETRY_AFTER}},
)
async def get_cell_state(service: Context, _caller: Reader, cell: CellInPath) -> Response:
    """Return the state of the cell's last measurement: which run, how far, since when. Less than 1 kB, made
    for a PLC that asks every second.
    """
    run = service.jobs.latest(cell.id)
    headers = {} if run is None else polling_headers(run.record)
    body = CellNow(**_now(service, cell)).model_dump_json()
    return Response(body, media_type="application/json", headers=headers)


@router.get(
    "/state",
    response_model=CellStates,
    responses={304: {"description": "Not changed since the ETag given in If-None-Match"}},
)
async def list_states(request: Request, service: Context, _caller: Reader) -> Response:
    """Return what every cell does, made to be asked every second: 0.5 kB a cell, with an `ETag`."""
    cells = [state_of(service, cell) for cell in service.cells.values()]
    body = CellStates(cells=cells, simulated=any(c.simulated for c in cells)).model_dump_json()
    headers = {"ETag": f'"{hashlib.sha256(body.encode()).hexdigest()[:16]}"', "Cache-Control": "no-cache"}
    if headers["ETag"] in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type="application/json", headers=headers)


def state_of(service: Service, cell: Cell) -> CellState:
    """Return the state of a cell, from memory."""
    run = service.jobs.latest(cell.id)
    now = {**_now(service, cell), "name": cell.config.robot}
    if run is not None and run.record.state in _GOING_ON:
        more = {k: v for k, v in run.progress if k not in now}
        moves = run.record.state is State.RUNNING
        return CellState(**now, **more, status=str(run.record.state), moves=moves)
    can_start = service.can_start.of(cell.id, lambda: service.readiness(cell))
    return CellState(**now, status="unknown" if can_start is None else "ready" if can_start else "not_ready")


def _short(phase: str) -> str:
    """Return a phase cut at a word, within one where it has no other."""
    if len(phase) <= _PHASE:
        return phase
    cut = shorten(phase, _PHASE, placeholder="…")
    return phase[:_PHASE] if cut == "…" else cut


def _now(service: Service, cell: Cell) -> dict[str, Any]:
    """Return the members of ``CellNow``."""
    run = service.jobs.latest(cell.id)
    if run is None:
        return {"cell": cell.id, "state": IDLE, "simulated": cell.simulated}
    facts, progress = run.record.facts, run.progress
    return {
        "cell": cell.id,
        "state": str(run.record.state),
        "run": run.record.id,
        "since": run.since,
        "phase": _short(progress.phase),
        "progress": progress.progress,
        "eta_s": None if progress.eta_s is None else round(progress.eta_s, 1),
        "motion_left_s": None if progress.motion_left_s is None else round(progress.motion_left_s, 1),
        "error": (facts.get("error") or {}).get("code"),
        "grade": (facts.get("summary") or {}).get("grade"),
        "simulated": cell.simulated,
    }


def overview(runs: Sequence[RunRecord]) -> Overview:
    """Return the line of a cell; ``runs`` are its measurements, the last started first."""
    done = [r for r in runs if r.state in ENDED or r.state is State.AWAITING_ACCEPT]
    last = done[0] if done else None
    changes = None if last is None else (last.facts.get("summary") or {}).get("changes")
    return Overview(
        last_run=None if last is None else _last_run(last), news=None if changes is None else _news(changes)
    )


def _last_run(run: RunRecord) -> LastRun:
    summary = run.facts.get("summary") or {}
    return LastRun(
        id=run.id,
        state=run.state,
        ended=run.ended,
        verdict=summary.get("verdict"),
        headline=summary.get("headline") or (run.facts.get("error") or {}).get("text"),
        grade=summary.get("grade"),
    )


def _has_news(changes: dict[str, Any]) -> bool:
    found = [*changes.get("parameters", []), *changes.get("causes", []), *changes.get("effects", [])]
    return any(entry.get("status") in _NEWS for entry in found) or bool(changes.get("structure"))


def _news(changes: dict[str, Any]) -> str:
    """Return the first of what changed."""
    return next(iter(changes.get("sentences", ())), "") if _has_news(changes) else ""
