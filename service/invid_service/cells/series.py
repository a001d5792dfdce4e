"""History of one parameter or cause over the models of a cell, with its uncertainty."""

from __future__ import annotations

import asyncio
import csv
import io
import math
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel

from invid.comparison.causes import main_parameter
from invid.comparison.numbers import name_of, numbers_of
from invid.errors import InvidError
from invid.model.document import Estimate, Model
from invid_service.dependencies import CellInPath, Context, Reader
from invid_service.jobs.results import load
from invid_service.problems import EVERYWHERE, Problem
from invid_service.store.store import StoredModel

router = APIRouter(tags=["cells"], responses=EVERYWHERE)
MOST = 200
"""Models looked at, the newest first."""


class Point(BaseModel):
    """One model's value; null where it does not have the cause."""

    model: str
    created: str
    mode: str
    accepted: bool
    value: float | None
    std: float | None


class Series(BaseModel):
    """History of one parameter or cause, oldest first."""

    cell: str
    parameter: str
    unit: str | None
    points: list[Point]
    simulated: bool


def sizes_of(model: Model) -> dict[str, Estimate]:
    """Return all of a model that has a history, by name: parameters, causes, and parameters of causes."""
    found = {name: row.new for name, row in numbers_of(model).items() if row.new is not None}
    for term in model.effects:
        main = main_parameter(term)
        if main is not None:
            found[name_of(term)] = term.parameters[main]
    return found


@router.get(
    "/cells/{cell}/series",
    response_model=Series,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
async def get_series(
    service: Context,
    _caller: Reader,
    cell: CellInPath,
    request: Request,
    parameter: Annotated[str, Query(max_length=200)],
    format: Literal["json", "csv"] | None = None,
) -> Response | Series:
    """Return the history of a parameter (`A1.mass.1`, `A1-A2.coupling`) or a cause (`A2.backlash.spring 1`).

    JSON, or CSV with `format=csv` or `Accept: text/csv`. Oldest first; of a cause a model without it has
    null. The names are those of `GET /cells/{cell}/changes`.
    """
    models = await asyncio.to_thread(service.store.models, cell.id, MOST)
    accepted = {a.model for a in await asyncio.to_thread(service.store.approvals, cell.id)}
    unit, points, known = await asyncio.to_thread(_points, list(reversed(models)), accepted, parameter)
    if parameter not in known:
        near = ", ".join(sorted(known)[:40]) or "no model yet"
        raise Problem(
            "parameter-not-found",
            f"no model of cell {cell.id} has {parameter[:64]!r}; known: {near}",
            simulated=cell.simulated,
        )
    if format == "csv" or (format is None and "text/csv" in request.headers.get("accept", "")):
        return Response(_csv(parameter, unit, points), media_type="text/csv; charset=utf-8")
    return Series(cell=cell.id, parameter=parameter, unit=unit, points=points, simulated=cell.simulated)


def _points(
    models: list[StoredModel], accepted: set[str], parameter: str
) -> tuple[str | None, list[Point], set[str]]:
    unit, points, known = None, [], set[str]()
    for stored in models:
        try:
            sizes = sizes_of(load(stored))
        except InvidError:  # a damaged text is said where the model itself is asked for
            continue
        known |= sizes.keys()
        one = sizes.get(parameter)
        unit = one.unit if one is not None else unit
        points.append(
            Point(
                model=stored.id,
                created=stored.created.isoformat(),
                mode=stored.mode,
                accepted=stored.id in accepted,
                value=None if one is None else one.value,
                std=None if one is None or one.std is None or not math.isfinite(one.std) else one.std,
            )
        )
    return unit, points, known


def _csv(parameter: str, unit: str | None, points: list[Point]) -> str:
    """Return the history as CSV: a header with the unit, one row a model; a missing number is an empty
    field.
    """
    out = io.StringIO()
    rows: Any = csv.writer(out)
    of = f" [{unit}]" if unit else ""
    rows.writerow(["created", "model", "mode", "accepted", f"{parameter}{of}", f"std{of}"])
    for p in points:
        rows.writerow([p.created, p.model, p.mode, str(p.accepted).lower(), p.value, p.std])
    return out.getvalue()
