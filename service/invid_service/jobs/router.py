"""Routes of identifications: start, follow, decide, fetch."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from fastapi.sse import format_sse_event

from invid_service.auth import Reader, Require, Runner
from invid_service.context import Context
from invid_service.events import EventLog, sse
from invid_service.jobs.doubts import why_untrusted
from invid_service.jobs.live import LiveRun, WrongStateError
from invid_service.jobs.manager import Decision
from invid_service.jobs.schema import (
    PARTS,
    RETRY_AFTER_S,
    ActionBody,
    Identification,
    IdentificationList,
    StartBody,
    polling_headers,
    view,
)
from invid_service.jobs.start import begin_identification
from invid_service.jobs.states import ENDED, State
from invid_service.keys import Scope
from invid_service.links import address
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, RETRY_AFTER, Problem, not_stored, problem_responses
from invid_service.service import Service
from invid_service.store.blobs import KINDS, Blob
from invid_service.store.store import RunRecord

router = APIRouter(tags=["identifications"], responses=EVERYWHERE)


@router.post(
    "/cells/{cell}/identifications",
    status_code=202,
    response_model=Identification,
    responses={**ACCEPTED, **problem_responses(409, 507)},
)
async def start_identification(
    cell: str,
    body: StartBody,
    response: Response,
    service: Context,
    caller: Runner,
    idempotency_key: Annotated[
        str | None, Header(alias="Idempotency-Key", min_length=1, max_length=255, pattern=r"^[!-~ ]+$")
    ] = None,
) -> Identification:
    """Start an identification. It goes on by itself: follow ``Location``.

    The same ``Idempotency-Key`` with the same body answers with the run it started the first time.
    """
    record = await begin_identification(service, cell, body, caller.name, idempotency_key)
    response.headers["Location"] = address("identifications", record.id)
    response.headers["Retry-After"] = str(RETRY_AFTER_S)
    return view(record, service.jobs.live(record.id))


@router.get("/identifications", response_model=IdentificationList)
async def list_identifications(  # noqa: PLR0913 - the query's parameters
    service: Context,
    _caller: Reader,
    cell: Annotated[str | None, Query(max_length=64, pattern=r"^[A-Za-z0-9_-]+$")] = None,
    state: Annotated[State | None, Query()] = None,
    since: Annotated[
        datetime | None, Query(description="Started at or after this time (UTC without a zone)")
    ] = None,
    until: Annotated[
        datetime | None, Query(description="Started before this time (UTC without a zone)")
    ] = None,
    cursor: Annotated[str | None, Query(max_length=40, pattern=r"^[A-Za-z0-9-]+$")] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
) -> IdentificationList:
    """List identifications, newest first. ``next`` is where a longer list goes on, with the same filters."""
    since, until = _in_utc(since), _in_utc(until)
    try:
        records = await asyncio.to_thread(
            service.store.runs,
            cell=cell,
            state=state,
            since=since,
            until=until,
            after=cursor,
            limit=limit + 1,
        )
    except KeyError:
        raise Problem("invalid-request", f"query.cursor: there is no identification {cursor!r}") from None
    items = [view(record, service.jobs.live(record.id), trace=False) for record in records[:limit]]
    following = None
    if len(records) > limit:
        given = {"cell": cell, "state": state, "since": since, "until": until, "limit": limit}
        query = {
            k: v.isoformat() if isinstance(v, datetime) else v for k, v in given.items() if v is not None
        }
        following = f"{address('identifications')}?{urlencode({**query, 'cursor': items[-1].id})}"
    return IdentificationList(
        identifications=items, simulated=any(i.simulated for i in items), next=following
    )


def _in_utc(instant: datetime | None) -> datetime | None:
    return instant if instant is None or instant.tzinfo else instant.replace(tzinfo=UTC)


@router.get(
    "/identifications/{identification}",
    response_model=Identification,
    responses={200: {"description": "As it is now", "headers": RETRY_AFTER}},
)
async def get_identification(identification: str, service: Context, _caller: Reader) -> Response:
    """Return state, progress, phase: plain polling is enough."""
    record, live = await service.run(identification)
    # Written here and not by the framework, which would check and turn it over twice: the busiest call.
    content = view(record, live, kept=await _kept(service, record)).model_dump_json()
    return Response(content, media_type="application/json", headers=polling_headers(record))


async def _kept(service: Service, record: RunRecord) -> set[str]:
    """Return the kinds of files in the store of a run that came to a result or to its end."""
    if record.state not in ENDED and record.state is not State.AWAITING_ACCEPT:
        return set()
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    return {kind for kind, blob in blobs.items() if blob is not None}


async def _part(service: Service, identification: str, name: str) -> dict[str, Any]:
    """Return one of the large parts of a run, whole; Problem 404 where the run has none."""
    record, _ = await service.run(identification)
    found = PARTS[name](record.facts)
    if found is None:
        raise Problem(
            "artefact-not-found",
            f"identification {record.id} is {record.state} and has no {name}",
            state=str(record.state),
            simulated=record.simulated,
        )
    return {**found, "simulated": record.simulated}


def _offer_part(name: str, operation: str, text: str) -> None:
    """Add the route of one of the large parts of a run."""

    async def get(identification: str, service: Context, _caller: Reader) -> dict[str, Any]:
        return await _part(service, identification, name)

    path = f"/identifications/{{identification}}/{name}"
    router.add_api_route(path, get, name=operation, description=text, response_model=dict[str, Any])


for _name, _operation, _text in (
    (
        "plan",
        "get_plan",
        "Return what was to move and how far; before and while it moves `plan` of the run has it, too.",
    ),
    (
        "measurement",
        "get_measurement",
        "Return what was seen while it moved, the drives and what they lack, how late the SYNCs were.",
    ),
    (
        "changes",
        "get_changes_of_identification",
        "Compare the result with the model that was in force then: every parameter, changed or not.",
    ),
):
    _offer_part(_name, _operation, _text)


@router.post(
    "/identifications/{identification}/actions",
    response_model=Identification,
    responses=problem_responses(409, 507),
)
async def act_on_identification(
    identification: str, body: ActionBody, request: Request, service: Context
) -> Identification:
    """Arm, cancel, accept or reject. Repeating what was already done is no error.

    A result that is not to be trusted (its ``untrusted`` says why) is accepted only with ``override``, a
    reason; it is kept with the decision.
    """
    scope = Scope.RUN if body.type in ("arm", "cancel") else Scope.ACCEPT
    caller = await Require(scope)(request)
    record, live = await service.run(identification)
    facts = {"identification": record.id, "cell": record.cell, "state": str(record.state)}
    doubt = why_untrusted(record.mode, record.facts.get("summary"))
    if body.type == "accept" and record.state is State.AWAITING_ACCEPT and doubt is not None:
        if body.override is None:
            raise Problem(
                "override-needed",
                f"{doubt}. To accept it all the same, say why in 'override'",
                simulated=record.simulated,
            )
        facts["override"] = body.override
    if body.by is not None and body.type in ("accept", "reject"):
        facts["by"] = body.by
    if body.type in ("arm", "accept"):
        try:
            await asyncio.to_thread(service.audit.write, body.type, caller=caller.name, **facts)
        except OSError as error:
            raise not_stored("the audit log", service.audit.path, error) from None
    try:
        await _apply(service, body, record, live, caller.name)
    except WrongStateError:
        record, _ = await service.run(identification)
        raise Problem(
            "wrong-state",
            f"{body.type!r} is not possible: the identification is {record.state}",
            state=str(record.state),
            simulated=record.simulated,
        ) from None
    if body.type in ("cancel", "reject"):
        await asyncio.to_thread(service.audit.try_write, body.type, caller=caller.name, **facts)
    record, live = await service.run(identification)
    return view(record, live, kept=await _kept(service, record))


async def _apply(
    service: Service, body: ActionBody, record: RunRecord, live: LiveRun | None, caller: str
) -> None:
    action = body.type
    if record.state in ENDED or live is None:
        decided = (record.facts.get("decision") or {}).get("type", "nothing")
        repeated = decided == {"accept": "accepted", "reject": "rejected"}.get(action)
        if action != "cancel" and not repeated:
            raise WrongStateError(str(record.state))
        return
    match action:
        case "arm":
            ready = await service.readiness(service.cell(record.cell or ""), record.mode, ignore=live)
            if record.state is State.AWAITING_ARM and not ready.can_start:
                raise Problem(
                    "not-ready",
                    "; ".join(r.text for r in ready.reasons),
                    reasons=[r.model_dump() for r in ready.reasons],
                    simulated=record.simulated,
                )
            await service.jobs.arm(live)
        case "cancel":
            await service.jobs.cancel(live)
        case _:
            doubt = why_untrusted(record.mode, record.facts.get("summary"))
            override = body.override if doubt is not None else None
            by = body.by or caller
            await service.jobs.decide(live, Decision(action == "accept", by, caller, override))


@router.get(
    "/identifications/{identification}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "Server-sent events",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        }
    },
)
async def follow_identification(
    identification: str,
    service: Context,
    _caller: Reader,
    last_event_id: Annotated[
        str | None, Header(alias="Last-Event-ID", max_length=20, pattern=r"^\d*$")
    ] = None,
    follow: Annotated[bool, Query(description="false: what there is, then the end")] = True,
) -> StreamingResponse:
    """Stream server-sent events ``state``, ``plan``, ``progress``; ends when the run has ended.

    Ids grow; ``Last-Event-ID`` resumes after one. A comment every few seconds keeps the line open.
    """
    record, live = await service.run(identification)
    after = int(last_event_id or 0)
    if live is not None:
        log = live.events
    else:
        log = EventLog(await asyncio.to_thread(service.store.events, record.id, after))
        log.close()

    async def stream() -> AsyncIterator[bytes]:
        yield format_sse_event(retry=1000)
        if not follow:
            for known in log.behind(after):
                yield sse(known)
            return
        async for event in log.follow(after, service.settings.keep_alive_s):
            yield sse(event)

    return StreamingResponse(
        stream(),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


def _has_already(given: str, tag: str) -> bool:
    """True where ``If-None-Match`` names the file as it is."""
    return any(t.strip().removeprefix("W/") in (tag, "*") for t in given.split(","))


def file_responses(media: str) -> dict[int | str, dict[str, Any]]:
    """OpenAPI responses of a stored file."""
    schema = {"type": "object"} if media == "application/json" else {"type": "string", "format": "binary"}
    return {
        **problem_responses(410),
        304: {"description": "Not changed since the ETag given in If-None-Match"},
        200: {"description": "The file", "content": {media.split(";")[0]: {"schema": schema}}},
    }


async def stored_file(service: Service, record: RunRecord, kind: str) -> Path:
    """Return the stored file of a run; Problem 404 before it exists and 410 after its retention."""
    return service.blobs.path((await _stored(service, record, kind)).path)


async def _stored(service: Service, record: RunRecord, kind: str) -> Blob:
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    if kind not in blobs:
        raise Problem(
            "artefact-not-found",
            f"identification {record.id} is {record.state} and has no {kind}",
            state=str(record.state),
            simulated=record.simulated,
        )
    blob = blobs[kind]
    if blob is None:
        raise Problem("artefact-expired", f"the {kind} of {record.id} was deleted after its retention")
    if not service.blobs.path(blob.path).is_file():
        raise Problem("artefact-not-found", f"the {kind} of {record.id} is missing in the store")
    return blob


async def artefact(service: Service, identification: str, kind: str, request: Request) -> Response:
    """Return the stored file of a run as an answer."""
    record, _ = await service.run(identification)
    blob = await _stored(service, record, kind)
    path = service.blobs.path(blob.path)
    name, media = KINDS[kind]
    headers = {"ETag": f'"{blob.sha256}"', "Cache-Control": "private, max-age=3600"}
    if _has_already(request.headers.get("if-none-match", ""), headers["ETag"]):
        return Response(status_code=304, headers=headers)
    if media.startswith("text/html"):
        headers["Content-Security-Policy"] = (
            "sandbox allow-popups; default-src 'none'; style-src 'unsafe-inline'; "
            "img-src data:; font-src data:"
        )
        return FileResponse(path, media_type=media, headers=headers)
    if kind == "corrected":  # the format is the simulator's
        name += Path(record.facts.get("simulator", "")).suffix
    return FileResponse(path, media_type=media, headers=headers, filename=f"{record.id}-{name}")


def _offer_file(kind: str, operation: str, text: str) -> None:
    """Add the route of one of the stored files of a run."""

    async def get(identification: str, request: Request, service: Context, _caller: Reader) -> Response:
        return await artefact(service, identification, kind, request)

    path = f"/identifications/{{identification}}/{kind}"
    responses = file_responses(KINDS[kind][1])
    router.add_api_route(
        path, get, name=operation, description=text, response_class=FileResponse, responses=responses
    )


for _kind, _operation, _text in (
    ("recording", "get_recording", "Return the measured data, HDF5; also what was measured before a stop."),
    ("model", "get_identified_model", "Return the identified model, with its effects."),
    ("diagnosis", "get_diagnosis", "Return what the simulation gets wrong."),
    ("report", "get_report", "Return the report, one self-contained HTML file."),
    ("plots", "get_plots", "Return the numbers behind the page's pictures."),
    (
        "corrected",
        "get_corrected_simulator",
        "Return the corrected copy of the simulator that was uploaded beside the recording, in its format; "
        "none where it is right or cannot be corrected (`against` of the diagnosis says so).",
    ),
    ("tuning-page", "get_tuning_page", "Return the page of the tuning, one self-contained HTML file."),
    (
        "tuning-picture",
        "get_tuning_picture",
        "Return Bode plots and the reference move, before and after, as SVG.",
    ),
    ("tuning-files", "get_tuning_files", "Return all files of the tuning in one archive (ZIP)."),
    ("verification", "get_verification", "Return the drives' loops as measured, beside what was predicted."),
    ("verification-picture", "get_verification_picture", "Return the loops, measured and predicted, as SVG."),
):
    _offer_file(_kind, _operation, _text)
