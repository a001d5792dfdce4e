"""Which cell of the database left its own population: the statistics of the whole fleet."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from pydantic import BaseModel

from invid.comparison.fleet import ALPHA, RunSizes, departures, fleet_history, run_sizes
from invid.errors import InvidError
from invid_service.auth import Reader
from invid_service.context import Context
from invid_service.jobs.results import load
from invid_service.problems import EVERYWHERE
from invid_service.query import refuse_unknown_parameters
from invid_service.service import Service

MOST_KEPT = 200_000
"""Models whose sizes are kept in memory (some 5 kB each): 1,000 cells for nearly four years of weeks."""


class ModelAt(BaseModel):
    """A model and its time."""

    model: str
    created: str


class DepartureEntry(BaseModel):
    """A parameter or cause that is not what it was, from the run ``since`` on, told by the run ``seen``."""

    cell: str
    parameter: str
    since: ModelAt
    seen: ModelAt
    before: float
    after: float
    difference_std: float
    p: float
    sentence: str


class Departures(BaseModel):
    """All departures, newest first, and how often one is chance."""

    cells: int
    runs: int
    false_alarm_rate: float
    departures: list[DepartureEntry]
    simulated: bool


def departures_router() -> APIRouter:
    """``GET /departures``."""
    router = APIRouter(
        tags=["cells"], responses=EVERYWHERE, dependencies=[Depends(refuse_unknown_parameters)]
    )
    known: dict[str, RunSizes | None] = {}  # models never change
    one_at_a_time = asyncio.Semaphore(1)

    @router.get("/departures", response_model=Departures)
    async def list_departures(
        service: Context,
        _caller: Reader,
        last: Annotated[int, Query(ge=2, le=200, description="Runs of each cell, the newest")] = 60,
        alpha: Annotated[float, Query(gt=0, le=0.1, description="False alarms in a run of a cell")] = ALPHA,
    ) -> Departures:
        """Which parameter or cause of which cell left its own population, over all cells of the database.

        Each cell is compared with its own runs; the scatter of runs is learnt from the whole fleet. Models
        that were only simulated do not count. `alpha` is the chance of a false alarm in one run of a cell.
        """
        async with one_at_a_time:
            return await asyncio.to_thread(_departures, service, known, last, alpha)

    return router


def _departures(service: Service, known: dict[str, RunSizes | None], last: int, alpha: float) -> Departures:
    runs: dict[str, list[RunSizes]] = {}
    models: dict[str, list[ModelAt]] = {}
    for cell in service.store.cells_with_models():
        runs[cell], models[cell] = [], []
        for stored in reversed(service.store.models(cell, last)):
            if stored.mode == "simulate":
                continue
            if stored.id not in known:
                if len(known) >= MOST_KEPT:
                    known.clear()
                try:
                    known[stored.id] = run_sizes(load(stored))
                except (InvidError, ValueError):  # a damaged text is said where the model is asked for
                    known[stored.id] = None
            sizes = known[stored.id]
            if sizes is not None:
                runs[cell].append(sizes)
                models[cell].append(ModelAt(model=stored.id, created=stored.created.isoformat()))
    found = [
        DepartureEntry(
            cell=d.cell,
            parameter=d.parameter,
            since=models[d.cell][d.since],
            seen=models[d.cell][d.seen],
            before=d.before,
            after=d.after,
            difference_std=d.std,
            p=d.p,
            sentence=d.sentence,
        )
        for d in departures(fleet_history(runs), alpha=alpha)
    ]
    return Departures(
        cells=len(runs),
        runs=sum(len(own) for own in runs.values()),
        false_alarm_rate=alpha,
        departures=sorted(found, key=lambda d: d.seen.created, reverse=True),
        simulated=any(c.simulated for c in service.cells.values()),
    )
