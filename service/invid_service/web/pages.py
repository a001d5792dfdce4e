"""The page: one document and its static files; data come through the REST interface only."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles
from jinja2 import Environment, FileSystemLoader

from invid import __version__

_HERE = Path(__file__).parent
_TEMPLATES = Environment(loader=FileSystemLoader(_HERE / "templates"), autoescape=True)
_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-src 'self'; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
router = APIRouter()


@router.get("/", response_class=HTMLResponse)
async def page(request: Request) -> HTMLResponse:
    """The page for the technician; it holds no data, so it needs no key."""
    service = request.app.state.service
    simulated = all(cell.simulated for cell in service.cells.values())
    html = _TEMPLATES.get_template("page.html").render(
        version=__version__, simulated=simulated, root=service.settings.root_path
    )
    return HTMLResponse(html, headers={"Content-Security-Policy": _POLICY, "Cache-Control": "no-cache"})


@router.get("/favicon.ico")
async def favicon() -> Response:
    """None; saves a line in every log."""
    return Response(status_code=204)


def static_files() -> StaticFiles:
    """Style, script and the vendored plot library."""
    return StaticFiles(directory=_HERE / "static")
