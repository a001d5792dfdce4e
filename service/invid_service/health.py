"""Routes for the cell's supervision: liveness, readiness of the service, metrics, version, audit."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel

from invid import __version__
from invid_service.dependencies import Admin, Context, Reader
from invid_service.metrics import CellFacts
from invid_service.problems import EVERYWHERE, ROOM, Problem, problem_responses
from invid_service.service import Service

_LOOKED_AT = 20
"""Runs of a cell among which its last result is."""
router = APIRouter(tags=["operations"], responses=EVERYWHERE)


class Live(BaseModel):
    """Answer that the process lives."""

    status: str = "live"


class Ready(BaseModel):
    """Answer whether the service can take work."""

    status: str = "ready"
    free_bytes: int
    cells_busy: int


class Version(BaseModel):
    """Versions of the program, the interface and the file formats."""

    name: str = "invid"
    version: str
    api: str = "v1"
    formats: dict[str, int]


@router.get("/health/live", response_model=Live)
async def get_liveness() -> Live:
    """Say that the process lives; needs no key and no store."""
    return Live()


@router.get("/health/ready", response_model=Ready, responses=problem_responses(507))
async def get_service_readiness(service: Context) -> Ready:
    """Say whether the service can take work: 503 while the store does not answer, the disk is full, or the
    service is going down.
    """
    free = service.blobs.free_bytes()
    answers, _ = await service.ask_store(service.store.ping)
    if not answers:
        raise Problem("store-unavailable", "the store does not answer", {"Retry-After": "2"})
    if service.shutting_down:
        raise Problem("store-unavailable", "the service is shutting down")
    if free < service.settings.min_free_bytes:
        needed = service.settings.min_free_bytes
        raise Problem("disk-full", f"{free} bytes are free, {needed} are needed; {ROOM}")
    busy = sum(service.jobs.occupying(c) is not None for c in service.cells)
    return Ready(free_bytes=free, cells_busy=busy)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def get_metrics(service: Context, _caller: Reader) -> Response:
    """Return metrics in Prometheus' text format. Cells are left out while the store does not answer."""
    _, cells = await service.ask_store(lambda: [_facts(service, cell) for cell in service.cells])
    return Response(service.metrics.text(cells or []), media_type="text/plain; version=0.0.4; charset=utf-8")


def _facts(service: Service, cell: str) -> CellFacts:
    """Return what the metrics say of a cell's last measurements."""
    runs = service.store.runs(cell=cell, limit=_LOOKED_AT, measured=True)
    runs = [run.record if (run := service.jobs.live(r.id)) is not None else r for r in runs]
    grades = [grade for r in runs if (grade := (r.facts.get("summary") or {}).get("grade")) is not None]
    return CellFacts(
        cell=cell,
        state=runs[0].state if runs else None,
        age_s=(service.clock() - runs[0].created).total_seconds() if runs else None,
        grade=grades[0] if grades else None,
    )


@router.get("/version", response_model=Version)
async def get_version() -> Version:
    """Return the version of the program, the interface and the file formats."""
    return Version(
        version=__version__, formats={"invid-recording": 1, "invid-model": 1, "invid-diagnosis": 1}
    )


@router.get("/audit", response_model=list[dict[str, Any]])
async def list_audit(
    service: Context, _caller: Admin, limit: Annotated[int, Query(ge=1, le=1000)] = 100
) -> list[dict[str, Any]]:
    """Return the newest lines of the audit log."""
    return await asyncio.to_thread(service.audit.tail, limit)
