"""Build the whole service from its settings; nothing is global."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from invid import __version__
from invid_service import health, problems
from invid_service.cells.router import router as cells
from invid_service.cells.series import router as series
from invid_service.cells.state import router as state
from invid_service.jobs.files import router as files
from invid_service.jobs.launcher import Launcher, launch_process
from invid_service.jobs.router import router as identifications
from invid_service.links import API
from invid_service.middleware import Guard
from invid_service.openapi import complete_schema
from invid_service.recordings.router import router as recordings
from invid_service.service import Clock, build, utc_now
from invid_service.settings import Settings
from invid_service.tuning.router import router as tuning
from invid_service.web.pages import router as pages
from invid_service.web.pages import static_files

DESCRIPTION = """\
Identify the elastic model of robot drives, and say what the simulation gets wrong.

Every failure is a problem document (RFC 9457) with a stable `type` (`urn:invid:problem:<id>`). Bodies
of a cell with no hardware behind it carry `"simulated": true`. Stopping through this interface is not
a safety function.
"""


def create_app(settings: Settings, *, launcher: Launcher = launch_process, clock: Clock = utc_now) -> FastAPI:
    """Return the application with its routers, middleware and OpenAPI document.

    Raises
    ------
    ConfigError
        Where a config, the keys or the store cannot be used, or the bind is open without a key.
    """
    service = build(settings, launcher, clock)

    @asynccontextmanager
    async def life(_app: FastAPI) -> AsyncIterator[None]:
        await service.start()
        try:
            yield
        finally:
            await service.close()

    app = FastAPI(
        title="invid",
        version=__version__,
        description=DESCRIPTION,
        lifespan=life,
        openapi_url=f"{API}/openapi.json",
        docs_url=None,  # Swagger's page comes from a CDN; cells are offline
        redoc_url=None,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.service = service
    problems.install(app)
    for router in (cells, state, series, identifications, files, tuning, recordings, health.router):
        app.include_router(router, prefix=API)
    # The usual addresses of supervision, beside those under the version.
    app.include_router(health.router, include_in_schema=False)
    app.include_router(pages, include_in_schema=False)
    app.mount("/static", static_files(), name="static")
    app.add_middleware(Guard, settings=settings, metrics=service.metrics)
    complete_schema(app)
    return app
