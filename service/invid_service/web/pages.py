"""Serve the page: one document and its static files; data come through the REST interface only."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response
from fastapi.staticfiles import StaticFiles
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from invid import __version__
from invid_service.web.texts import LANGUAGES, catalogue, sayings, wanted

_HERE = Path(__file__).parent
_TEMPLATES = Environment(
    loader=FileSystemLoader(_HERE / "templates"), autoescape=True, undefined=StrictUndefined
)
_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-src 'self'; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
router = APIRouter()


@router.get("/", response_class=HTMLResponse)
async def page(request: Request) -> HTMLResponse:
    """Return the page in the language of the browser; it holds no data, so it needs no key."""
    service = request.app.state.service
    simulated = all(cell.simulated for cell in service.cells.values())
    language = wanted(request)
    texts = catalogue(language)
    html = _TEMPLATES.get_template("page.html").render(
        version=__version__,
        simulated=simulated,
        root=service.settings.root_path,
        language=language,
        languages={name: catalogue(name)["language.name"] for name in LANGUAGES},
        t=texts.__getitem__,
        # Within the page, so that its stop button never waits for a second file. No "<" ends a script early.
        texts=_embedded(texts),
        said=_embedded(sayings(language)),
    )
    headers = {
        "Content-Security-Policy": _POLICY,
        "Cache-Control": "no-cache",
        "Content-Language": language,
        "Vary": "Accept-Language, Cookie",
    }
    return HTMLResponse(html, headers=headers)


def _embedded(texts: Mapping[str, str]) -> Markup:
    return Markup(json.dumps(dict(texts), ensure_ascii=False).replace("<", "\\u003c"))


@router.get("/favicon.ico")
async def favicon() -> Response:
    """Answer that there is no icon; saves a line in every log."""
    return Response(status_code=204)


def static_files() -> StaticFiles:
    """Return the files of style, script, texts and the vendored plot library."""
    return StaticFiles(directory=_HERE / "static")
