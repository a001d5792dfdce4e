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
from invid.wording.sentence import LANGUAGES, catalogue
from invid_service.web.texts import texts_of

_HERE = Path(__file__).parent
_TEMPLATES = Environment(
    loader=FileSystemLoader(_HERE / "templates"), autoescape=True, undefined=StrictUndefined
)
_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-src 'self'; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
COOKIE = "invid-language"
router = APIRouter()


@router.get("/", response_class=HTMLResponse)
async def page(request: Request) -> HTMLResponse:
    """Return the page in the language of the browser; it holds no data, so it needs no key."""
    service = request.app.state.service
    simulated = all(cell.simulated for cell in service.cells.values())
    language = wanted(request)
    texts = texts_of(language)
    html = _TEMPLATES.get_template("page.html").render(
        version=__version__,
        simulated=simulated,
        root=service.settings.root_path,
        language=language,
        languages={name: texts_of(name)["language.name"] for name in LANGUAGES},
        t=texts.__getitem__,
        # Within the page, so that its stop button never waits for a second file. No "<" ends a script early.
        texts=_embedded(texts),
        wording=_embedded(catalogue(language)),
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


def wanted(request: Request) -> str:
    """Return the language chosen on the page before, else the first of the browser's that is there."""
    chosen = request.cookies.get(COOKIE, "")
    return chosen if chosen in LANGUAGES else preferred(request.headers.get("accept-language", ""))


def preferred(header: str) -> str:
    """Return the best language of an ``Accept-Language`` header ("de-CH,de;q=0.9,en;q=0.8")."""
    ranked: list[tuple[float, int, str]] = []
    for place, part in enumerate(header.split(",")[:50]):
        tag, _, weight = part.strip().partition(";")
        try:
            share = float(weight.strip().removeprefix("q=")) if weight else 1.0
        except ValueError:
            continue
        language = tag.split("-")[0].strip().lower()
        if language in LANGUAGES and share > 0:
            ranked.append((-share, place, language))
    return min(ranked)[2] if ranked else LANGUAGES[0]


def static_files() -> StaticFiles:
    """Return the files of style, script, texts and the vendored plot library."""
    return StaticFiles(directory=_HERE / "static")
