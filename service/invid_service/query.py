"""Refuse query parameters that a call does not know: a misspelt filter must not pass for none."""

from __future__ import annotations

from fastapi import Request
from fastapi.routing import APIRoute

from invid_service.problems import Problem


def refuse_unknown_parameters(request: Request) -> None:
    """Raise problem ``invalid-request`` for an unknown parameter, with those that the call has."""
    route = request.scope.get("route")
    if not request.query_params or not isinstance(route, APIRoute):
        return
    known = sorted(p.alias for p in route.dependant.query_params)
    unknown = sorted(set(request.query_params) - set(known))
    if unknown:
        has = f"it has {', '.join(known)}" if known else "it has none"
        raise Problem("invalid-request", f"query: this call has no parameter {unknown[0][:64]!r}; {has}")
