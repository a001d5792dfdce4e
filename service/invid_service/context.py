"""Give a route the service behind its request."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from invid_service.service import Service


def _service(request: Request) -> Service:
    found: Service = request.app.state.service
    return found


async def _context(request: Request) -> Service:
    return _service(request)


Context = Annotated[Service, Depends(_context)]
