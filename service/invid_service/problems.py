"""Answer failures with problem documents (RFC 9457): a stable ``type``, a sentence and a way out."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from invid import disk
from invid.errors import InputError
from invid.wording.sentence import sentence, with_wording
from invid_service.store.database import is_full
from invid_service.words import PROBLEMS

MEDIA_TYPE = "application/problem+json"
URN = "urn:invid:problem:"

STATUSES: dict[str, int] = {
    "bad-request": 400,
    "key-missing": 401,
    "key-invalid": 401,
    "scope-missing": 403,
    "foreign-origin": 403,
    "not-found": 404,
    "cell-not-found": 404,
    "identification-not-found": 404,
    "model-not-found": 404,
    "parameter-not-found": 404,
    "artefact-not-found": 404,
    "method-not-allowed": 405,
    "run-in-progress": 409,
    "not-ready": 409,
    "wrong-state": 409,
    "override-needed": 409,
    "nothing-to-separate": 409,
    "not-simulated": 409,
    "not-tunable": 409,
    "no-comparison": 409,
    "artefact-expired": 410,
    "length-required": 411,
    "too-large": 413,
    "unsupported-media-type": 415,
    "invalid-request": 422,
    "invalid-recording": 422,
    "idempotency-key-reused": 422,
    "upload-stalled": 408,
    "internal-error": 500,
    "store-unavailable": 503,
    "disk-full": 507,
}
"""id -> status; its title is in ``words.PROBLEMS``. Ids are stable: never renamed, never given
another meaning."""

log = logging.getLogger(__name__)


class Refusal(BaseModel):
    """One reason why a cell cannot start."""

    code: str
    text: str
    fix: str


class WrongValue(BaseModel):
    """One value of the request that cannot be used."""

    where: str
    message: str


class ProblemDocument(BaseModel):
    """Problem document of RFC 9457 with further members by type; each is left out where it says nothing."""

    model_config = ConfigDict(extra="allow")
    type: str = Field(description=f"`{URN}` and one of: {', '.join(STATUSES)}; more may come")
    title: str
    status: int
    detail: str = Field(description="What, where, the value found, the way out")
    instance: str | None = Field(default=None, description="The path that was asked for")
    simulated: bool | None = Field(default=None, description="true: of a cell with no hardware behind it")
    state: str | None = Field(default=None, description="wrong-state, artefact-not-found, …: of the run")
    identification: str | None = Field(default=None, description="run-in-progress: the run's id")
    location: str | None = Field(default=None, description="run-in-progress: the run's address")
    reasons: list[Refusal] | None = Field(default=None, description="not-ready, run-in-progress")
    errors: list[WrongValue] | None = Field(default=None, description="invalid-request: at most twenty")
    scope: str | None = Field(default=None, description="scope-missing: the scope that the key lacks")
    limit: int | None = Field(default=None, description="too-large: bytes that are taken")


class Problem(Exception):
    """Error raised anywhere in a request and answered as a problem document."""

    def __init__(self, kind: str, detail: str, headers: dict[str, str] | None = None, **members: Any) -> None:
        super().__init__(detail)
        self.kind, self.detail, self.headers, self.members = kind, detail, headers, members

    @property
    def status(self) -> int:
        """Return the HTTP status of this kind."""
        return STATUSES[self.kind]

    def response(self, instance: str) -> JSONResponse:
        """Return the document, ready to send."""
        document = {**document_of(self.kind, self.detail), "instance": instance, **self.members}
        return JSONResponse(with_wording(document), self.status, self.headers, MEDIA_TYPE)


def document_of(kind: str, detail: str) -> dict[str, Any]:
    """Return the members that every problem document has."""
    title = sentence(PROBLEMS[kind])
    return {"type": URN + kind, "title": title, "status": STATUSES[kind], "detail": detail}


RETRY_AFTER: dict[str, Any] = {
    "Retry-After": {
        "schema": {"type": "integer"},
        "description": "Seconds until it is worth while to ask again",
    }
}
"""OpenAPI ``headers`` of an answer that has it."""
_HEADERS: dict[int, dict[str, Any]] = {
    401: {"WWW-Authenticate": {"schema": {"type": "string"}, "description": "Bearer"}},
    409: RETRY_AFTER,
    503: RETRY_AFTER,
}


ROOM = "make room on the disk of the service's data (delete old files there, or shorten retention_days)"


@contextlib.contextmanager
def storing(what: str, path: Path) -> Iterator[None]:
    """Problem where this file cannot be written within: its name, the reason, the room, the way out."""
    try:
        yield
    except OSError as error:
        text = f"{what} ({path.name}) cannot be written: {error.strerror or error}"
        if not disk.is_full(error):
            why = f"{text}; see who may write in the service's data folder"
            raise Problem("store-unavailable", why) from None
        raise Problem("disk-full", f"{text}, {disk.free(path.parent)}; {ROOM}, then try again") from None


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return OpenAPI ``responses`` for these statuses, with the types of problem that have them."""
    return {
        status: {
            "description": f"{HTTPStatus(status).phrase}: {', '.join(_kinds(status))}",
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}},
            **({"headers": _HEADERS[status]} if status in _HEADERS else {}),
        }
        for status in statuses
    }


def _kinds(status: int) -> list[str]:
    return [kind for kind, code in STATUSES.items() if code == status]


EVERYWHERE = problem_responses(400, 401, 403, 404, 405, 413, 415, 422, 500, 503)
"""Failures that any request may meet."""


def install(app: FastAPI) -> None:
    """Map every exception to a problem document.

    One about a cell, or a run of one, with no hardware behind it says so as answers do. Who has no key for it
    learns nothing of it.
    """

    async def answer(request: Request, problem: Problem) -> JSONResponse:
        cell = app.state.service.cells.get(request.path_params.get("cell", ""))
        found = getattr(request.state, "simulated", False) or (cell is not None and cell.simulated)
        if found and problem.status not in (401, 403):
            problem.members.setdefault("simulated", True)
        return problem.response(request.url.path)

    @app.exception_handler(Problem)
    async def _problem(request: Request, error: Problem) -> JSONResponse:
        return await answer(request, error)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = [
            {"where": ".".join(str(part) for part in e["loc"]), "message": e["msg"]} for e in error.errors()
        ]
        media = request.headers.get("content-type", "").split(";")[0].strip().lower()
        # A body of another type reaches us as bytes, and would be said to be no dictionary.
        if media and not media.endswith("json") and any(e["where"] == "body" for e in errors):
            detail = f"the body is sent as {media[:80]!r}; send JSON with Content-Type: application/json"
            return await answer(request, Problem("unsupported-media-type", detail))
        first = errors[0] if errors else {"where": "request", "message": "cannot be read"}
        detail = f"{first['where']}: {first['message']}"
        return await answer(request, Problem("invalid-request", detail, errors=errors[:20]))

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        others = ["bad-request" if error.status_code < 500 else "internal-error"]
        kind = (_kinds(error.status_code) or others)[0]
        detail = {
            404: f"nothing is served at {request.url.path}; the calls are listed in /api/v1/openapi.json",
            405: f"{request.method} is not possible at {request.url.path}",
        }.get(error.status_code, str(error.detail))
        headers = dict(error.headers) if error.headers else None
        # The router's own, before anybody was asked for a key: nothing of the cell is told.
        return Problem(kind, detail, headers).response(request.url.path)

    @app.exception_handler(InputError)
    async def _input(request: Request, error: InputError) -> JSONResponse:
        return await answer(request, Problem("invalid-request", str(error)))

    @app.exception_handler(SQLAlchemyError)
    async def _store(request: Request, error: SQLAlchemyError) -> JSONResponse:
        log.error("store: %s: %s", type(error).__name__, error)
        detail = (
            f"the store takes no more, its disk is full; a stop still works, {ROOM}"
            if is_full(error)
            else "the store did not answer in time; a stop still works, try this again in a moment"
        )
        return await answer(request, Problem("store-unavailable", detail, {"Retry-After": "2"}))

    @app.exception_handler(Exception)
    async def _internal(request: Request, error: Exception) -> JSONResponse:
        log.exception("internal error at %s %s", request.method, request.url.path)
        detail = f"{type(error).__name__}; the log of the service says where"
        return await answer(request, Problem("internal-error", detail))
