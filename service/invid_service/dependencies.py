"""What routes ask for: the service, who calls and may, the cell or the run that the path names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request
from fastapi.routing import APIRoute

from invid_service.auth import identify_caller, refuse_other_sites
from invid_service.cells.registry import Cell
from invid_service.jobs.live import LiveRun
from invid_service.keys import NOBODY, Caller, Scope
from invid_service.problems import Problem
from invid_service.service import Service
from invid_service.store.store import RunRecord


async def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


Context = Annotated[Service, Depends(_service)]


def _refuse_unknown_parameters(request: Request) -> None:
    """Raise problem ``invalid-request`` for an unknown parameter, with those that the call has."""
    route = request.scope.get("route")
    if not request.query_params or not isinstance(route, APIRoute):
        return
    known = sorted(p.alias for p in route.dependant.query_params)
    unknown = sorted(set(request.query_params) - set(known))
    if unknown:
        has = f"it has {', '.join(known)}" if known else "it has none"
        raise Problem("invalid-request", f"query: this call has no parameter {unknown[0][:64]!r}; {has}")


class Require:
    """FastAPI dependency that returns the caller, who must have ``scope``."""

    def __init__(self, scope: Scope) -> None:
        self.scope = scope

    async def __call__(self, request: Request) -> Caller:
        caller = identify_caller(request)
        if not caller.may(self.scope):
            raise Problem(
                "scope-missing",
                f"the key {caller.name!r} lacks the scope {self.scope}",
                scope=str(self.scope),
            )
        _refuse_unknown_parameters(request)
        return caller


Known = Annotated[Caller, Depends(identify_caller)]
"""Whoever may call at all; what for is asked by the route."""
Reader = Annotated[Caller, Depends(Require(Scope.READ))]
Runner = Annotated[Caller, Depends(Require(Scope.RUN))]
Accepter = Annotated[Caller, Depends(Require(Scope.ACCEPT))]
Admin = Annotated[Caller, Depends(Require(Scope.ADMIN))]


async def _stopping_caller(request: Request) -> Caller:
    """Return whoever asks for a stop: with a key that is missing, wrong or revoked, or through a proxy that
    changes the host, it stops as well.
    """
    refuse_other_sites(request)
    try:
        return identify_caller(request)
    except Problem:
        return NOBODY


Stopper = Annotated[Caller, Depends(_stopping_caller)]


async def _cell(cell: str, service: Context) -> Cell:
    return service.cell(cell)


CellInPath = Annotated[Cell, Depends(_cell)]
"""404 where there is none. It stands behind the caller: who may not ask learns nothing."""


@dataclass(frozen=True)
class FoundRun:
    """A run as stored, and in memory while it lives."""

    record: RunRecord
    live: LiveRun | None

    def problem(self, kind: str, what: str) -> Problem:
        """Return the problem that this run has no such thing, or is in no such state."""
        state = str(self.record.state)
        return Problem(kind, f"identification {self.record.id} is {state}{what}", state=state)


async def find_run(identification: str, request: Request, service: Context) -> FoundRun:
    """Return a run; Problem 404 where there is none. What is refused of one then says what is behind it."""
    run = FoundRun(*await service.run(identification))
    request.state.simulated = run.record.simulated
    return run


RunInPath = Annotated[FoundRun, Depends(find_run)]
"""404 where there is none; behind the caller, as ``CellInPath``."""
