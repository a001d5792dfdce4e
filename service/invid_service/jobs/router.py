"""Routes of identifications: start, follow, decide, fetch."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from datetime import UTC, datetime
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import StreamingResponse
from fastapi.sse import format_sse_event

from invid.wording.sentence import with_wording
from invid_service.dependencies import (
    CellInPath,
    Context,
    FoundRun,
    Known,
    Reader,
    Require,
    RunInPath,
    Runner,
)
from invid_service.events import EventLog, sse
from invid_service.jobs.doubts import why_untrusted
from invid_service.jobs.live import WrongStateError
from invid_service.jobs.manager import Decision
from invid_service.jobs.schema import (
    PARTS,
    ActionBody,
    Identification,
    IdentificationList,
    StartBody,
    following,
    polling_headers,
    view,
)
from invid_service.jobs.start import begin_identification
from invid_service.jobs.states import ENDED, State
from invid_service.keys import Scope
from invid_service.links import address
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, RETRY_AFTER, Problem, problem_responses, storing
from invid_service.service import Service

router = APIRouter(tags=["identifications"], responses=EVERYWHERE)


@router.post(
    "/cells/{cell}/identifications",
    status_code=202,
    response_model=Identification,
    responses={**ACCEPTED, **problem_responses(409, 507)},
)
async def start_identification(
    body: StartBody,
    response: Response,
    service: Context,
    caller: Runner,
    cell: CellInPath,
    idempotency_key: Annotated[
        str | None, Header(alias="Idempotency-Key", min_length=1, max_length=255, pattern=r"^[!-~ ]+$")
    ] = None,
) -> Identification:
    """Start an identification. It goes on by itself: follow ``Location``.

    The same ``Idempotency-Key`` with the same body answers with the run it started the first time.
    """
    record = await begin_identification(service, cell, body, caller.name, idempotency_key)
    response.headers.update(following(record.id))
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
async def get_identification(service: Context, _caller: Reader, run: RunInPath) -> Response:
    """Return state, progress, phase: plain polling is enough."""
    # Written here and not by the framework, which would check and turn it over twice: the busiest call.
    content = (await _whole(service, run)).model_dump_json()
    return Response(content, media_type="application/json", headers=polling_headers(run.record))


async def _whole(service: Service, run: FoundRun) -> Identification:
    """Return a run with what it left in the store, once it came to a result or to its end."""
    kept: set[str] = set()
    if run.record.state in ENDED or run.record.state is State.AWAITING_ACCEPT:
        blobs = await asyncio.to_thread(service.store.artefacts, run.record.id)
        kept = {kind for kind, blob in blobs.items() if blob is not None}
    return view(run.record, run.live, kept=kept)


def _offer_part(name: str, operation: str, text: str) -> None:
    """Add the route of one of the large parts of a run."""

    async def get(_caller: Reader, run: RunInPath) -> dict[str, Any]:
        found = PARTS[name](run.record.facts)
        if found is None:
            raise run.problem("artefact-not-found", f" and has no {name}")
        return with_wording({**found, "simulated": run.record.simulated})

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
    body: ActionBody, request: Request, service: Context, _caller: Known, run: RunInPath
) -> Identification:
    """Arm, cancel, accept or reject. Repeating what was already done is no error.

    A result that is not to be trusted (its ``untrusted`` says why) is accepted only with ``override``, a
    reason; it is kept with the decision.
    """
    decides = body.type in ("accept", "reject")
    caller = await Require(Scope.ACCEPT if decides else Scope.RUN)(request)
    record = run.record
    facts = {"identification": record.id, "cell": record.cell, "state": str(record.state)}
    doubt = why_untrusted(record.mode, record.facts.get("summary"))
    override = body.override if doubt is not None else None
    if body.type == "accept" and record.state is State.AWAITING_ACCEPT and doubt is not None:
        if override is None:
            raise Problem("override-needed", f"{doubt}. To accept it all the same, say why in 'override'")
        facts["override"] = override
    if body.by is not None and decides:
        facts["by"] = body.by
    if body.type in ("arm", "accept"):
        with storing("the audit log", service.audit.path):
            await asyncio.to_thread(service.audit.write, body.type, caller=caller.name, **facts)
    try:
        await _apply(
            service, body, run, Decision(body.type == "accept", body.by or caller.name, caller.name, override)
        )
    except WrongStateError:
        now, _ = await service.run(record.id)
        text = f"{body.type!r} is not possible: the identification is {now.state}"
        raise Problem("wrong-state", text, state=str(now.state)) from None
    if body.type in ("cancel", "reject"):
        await asyncio.to_thread(service.audit.try_write, body.type, caller=caller.name, **facts)
    return await _whole(service, FoundRun(*await service.run(record.id)))


async def _apply(service: Service, body: ActionBody, run: FoundRun, decision: Decision) -> None:
    action, record, live = body.type, run.record, run.live
    if record.state in ENDED or live is None:
        decided = (record.facts.get("decision") or {}).get("type", "nothing")
        repeated = decided == {"accept": "accepted", "reject": "rejected"}.get(action)
        if action != "cancel" and not repeated:
            raise WrongStateError(str(record.state))
    elif action == "arm":
        ready = await service.readiness(service.cell(record.cell or ""), record.mode, ignore=live)
        if record.state is State.AWAITING_ARM and not ready.can_start:
            raise ready.problem()
        await service.jobs.arm(live)
    elif action == "cancel":
        await service.jobs.cancel(live)
    else:
        await service.jobs.decide(live, decision)


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
    service: Context,
    _caller: Reader,
    run: RunInPath,
    last_event_id: Annotated[
        str | None, Header(alias="Last-Event-ID", max_length=20, pattern=r"^\d*$")
    ] = None,
    follow: Annotated[bool, Query(description="false: what there is, then the end")] = True,
) -> StreamingResponse:
    """Stream server-sent events ``state``, ``plan``, ``progress``; ends when the run has ended.

    Ids grow; ``Last-Event-ID`` resumes after one. A comment every few seconds keeps the line open.
    """
    after = int(last_event_id or 0)
    if run.live is not None:
        log = run.live.events
    else:
        log = EventLog(await asyncio.to_thread(service.store.events, run.record.id, after))
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
