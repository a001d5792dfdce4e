"""Routes of cells: what they are, whether they can start, their stop, their models."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import JSONResponse

from invid.errors import InputError
from invid.model.document import parse_json
from invid.wording.sentence import with_wording
from invid_service.cells.changes import changes_view
from invid_service.cells.readiness import Checked, Readiness
from invid_service.cells.registry import Cell
from invid_service.cells.schema import (
    AcceptedModel,
    AxisLimits,
    CellList,
    CellView,
    Drive,
    ModelEntry,
    ModelList,
    RestoreBody,
    SimulationPatch,
    SimulationView,
    StopAnswer,
    StopAnswers,
)
from invid_service.cells.state import overview
from invid_service.dependencies import Accepter, CellInPath, Context, Reader, Runner, Stopper
from invid_service.jobs.schema import view
from invid_service.jobs.states import State
from invid_service.keys import NOBODY, Caller
from invid_service.links import address
from invid_service.problems import EVERYWHERE, Problem, problem_responses
from invid_service.service import Service
from invid_service.store.store import Approval, StoredModel

router = APIRouter(tags=["cells"], responses=EVERYWHERE)
_LOOKED_AT = 2
"""Runs of a cell from which its overview is made: one in progress, and the one before it."""
_background: set[asyncio.Future[None]] = set()


@router.get("/cells", response_model=CellList)
async def list_cells(service: Context, _caller: Reader) -> CellList:
    """List all cells."""
    views = [await _cell_view(service, cell) for cell in service.cells.values()]
    return CellList(cells=views, simulated=any(v.simulated for v in views))


@router.get("/cells/{cell}", response_model=CellView)
async def get_cell(service: Context, _caller: Reader, cell: CellInPath) -> CellView:
    """Return one cell: drives, limits, the model in force, the last identification."""
    return await _cell_view(service, cell)


async def _cell_view(service: Service, cell: Cell) -> CellView:
    config = cell.config
    approvals = await asyncio.to_thread(service.store.approvals, cell.id)
    runs = await asyncio.to_thread(service.store.runs, cell=cell.id, limit=_LOOKED_AT, measured=True)
    runs = [run.record if (run := service.jobs.live(r.id)) is not None else r for r in runs]
    torque, position = ("N", "m") if config.linear else ("N·m", "rad")
    return CellView(
        id=cell.id,
        name=config.robot,
        robot=config.robot,
        simulated=cell.simulated,
        axes=list(cell.axes),
        bus={"interface": config.bus.interface, "channel": config.bus.channel, "cycle_s": config.bus.cycle_s},
        drives=[
            Drive(
                axis=a.name, node_id=a.node_id, vendor=a.vendor, rated_torque=a.rated_torque, hold=a.hold.mode
            )
            for a in config.axes
        ],
        limits=[
            AxisLimits(
                axis=a.name,
                torque=a.limits.torque,
                position=a.limits.position,
                velocity=a.limits.velocity,
                torque_unit=torque,
                position_unit=position,
            )
            for a in config.axes
        ],
        model=_accepted(approvals[0]) if approvals else None,
        last_identification=view(runs[0], service.jobs.live(runs[0].id), trace=False) if runs else None,
        overview=overview(runs),
        links={
            name: address("cells", cell.id, name)
            for name in (
                "readiness",
                "check",
                "identifications",
                "stop",
                "model",
                "models",
                "changes",
                "series",
            )
        },
    )


def _accepted(a: Approval) -> AcceptedModel:
    return AcceptedModel(id=a.model, accepted=a.at, by=a.by, how=a.how)


@router.get("/cells/{cell}/readiness", response_model=Readiness)
async def get_readiness(service: Context, _caller: Reader, cell: CellInPath) -> Readiness:
    """Say whether a measurement can start now; if not, why, and what to do about it.

    Nothing is sent to the drives: what is known of them is what a run or `POST /cells/{cell}/check` saw last
    (`seen`).
    """
    return await service.readiness(cell)


@router.post("/cells/{cell}/check", response_model=Checked, responses=problem_responses(409))
async def check_drives(service: Context, caller: Runner, cell: CellInPath) -> Checked:
    """Ask the drives, as `invid check` does, and say whether a measurement can start. Moves nothing.

    Drives that are off are taken pre-operational, and settings that an earlier run left in them are restored;
    to drives under power nothing is sent but questions.
    """
    await asyncio.to_thread(service.audit.try_write, "check", caller=caller.name, cell=cell.id)
    return await service.check(cell)


@router.post("/cells/{cell}/stop", response_model=StopAnswer)
async def stop_cell(service: Context, caller: Stopper, cell: CellInPath) -> StopAnswer:
    """Stop motion at once. This is **not a safety function**: it goes through a network, an operating
    system and the drives' protocol. Use the emergency stop where people are in danger.

    It needs no key: whoever reaches the service may stop. The answer does not wait for the drives; the
    identification becomes ``stopped``. Stopping what stands still is no error: asked again until
    ``stopping`` is false, a stop is confirmed.
    """
    return _stop(service, cell, caller)


@router.post("/stop", response_model=StopAnswers)
async def stop_all_cells(service: Context, caller: Stopper) -> StopAnswers:
    """Stop motion of all cells at once, and say for each whether something moved. As of one cell: **not a
    safety function**, and it needs no key.
    """
    answers = [_stop(service, cell, caller) for cell in service.cells.values()]
    return StopAnswers(cells=answers, simulated=any(a.simulated for a in answers))


def _stop(service: Service, cell: Cell, caller: Caller) -> StopAnswer:
    run = service.jobs.stop_cell(cell.id)
    service.metrics.stopped(cell.id)
    identification = None if run is None else run.record.id
    # In a thread of its own, after the fact: a disk that hangs must not delay a stop. And whoever has no key
    # does not fill the disk with stops of what stands still.
    if run is not None or caller is not NOBODY:
        _later(service, "stop", caller=caller.name, cell=cell.id, identification=identification)
    return StopAnswer(
        cell=cell.id,
        stopping=run is not None,
        moved=run is not None and run.record.state is State.RUNNING,
        unknown=run is None and service.jobs.is_lost(cell.id),
        identification=identification,
        simulated=cell.simulated,
    )


def _later(service: Service, action: str, **facts: Any) -> None:
    future = asyncio.ensure_future(asyncio.to_thread(service.audit.try_write, action, **facts))
    _background.add(future)
    future.add_done_callback(_background.discard)


@router.get(
    "/cells/{cell}/model",
    responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}},
    response_class=JSONResponse,
)
async def get_accepted_model(service: Context, _caller: Reader, cell: CellInPath) -> JSONResponse:
    """Return the model in force."""
    model = await asyncio.to_thread(service.results.in_force, cell.id)
    if model is None:
        raise Problem(
            "model-not-found",
            f"cell {cell.id} has no accepted model yet; identify it and accept the result",
            simulated=cell.simulated,
        )
    return _document(cell, model)


def _document(cell: Cell, model: StoredModel) -> JSONResponse:
    return JSONResponse(
        with_wording({**parse_json(model.document), "id": model.id, "simulated": cell.simulated})
    )


@router.get("/cells/{cell}/models", response_model=ModelList)
async def list_models(service: Context, _caller: Reader, cell: CellInPath) -> ModelList:
    """List every model identified on the cell, and the history of those in force."""
    stored = await asyncio.to_thread(service.store.models, cell.id)
    approvals = [_accepted(a) for a in await asyncio.to_thread(service.store.approvals, cell.id)]
    in_force = approvals[0].id if approvals else None
    entries = [
        ModelEntry(
            id=m.id,
            created=m.created,
            mode=m.mode,
            in_force=m.id == in_force,
            accepted=[a for a in approvals if a.id == m.id],
        )
        for m in stored
    ]
    return ModelList(models=entries, history=approvals, simulated=cell.simulated)


async def _stored_model(service: Service, cell: Cell, identity: str) -> StoredModel:
    model = None
    if len(identity) <= 40 and identity.isascii() and identity.replace("-", "").isalnum():
        model = await asyncio.to_thread(service.store.model, cell.id, identity)
    if model is None:
        raise Problem(
            "model-not-found", f"cell {cell.id} has no model {identity[:64]!r}", simulated=cell.simulated
        )
    return model


@router.get(
    "/cells/{cell}/models/{model}",
    responses={200: {"content": {"application/json": {"schema": {"type": "object"}}}}},
    response_class=JSONResponse,
)
async def get_model(model: str, service: Context, _caller: Reader, cell: CellInPath) -> JSONResponse:
    """Return one model of the cell, accepted or not."""
    return _document(cell, await _stored_model(service, cell, model))


@router.post("/cells/{cell}/models/{model}/restore", response_model=ModelList)
async def restore_model(
    model: str, service: Context, caller: Accepter, cell: CellInPath, body: RestoreBody | None = None
) -> ModelList:
    """Take an earlier model into force again; the history keeps both."""
    stored = await _stored_model(service, cell, model)
    history = await asyncio.to_thread(service.store.approvals, cell.id)
    if not any(a.model == stored.id for a in history):
        raise Problem(
            "model-not-found",
            f"model {stored.id} was never accepted; only accepted models can be restored",
            simulated=cell.simulated,
        )
    by = (body or RestoreBody()).by or caller.name
    facts = {"cell": cell.id, "model": stored.id, "by": by}
    await asyncio.to_thread(service.audit.try_write, "restore", caller=caller.name, **facts)
    if history[0].model != stored.id:
        await asyncio.to_thread(
            service.store.approve, cell.id, stored.id, by=by, how="restore", now=service.clock()
        )
    return await list_models(service, caller, cell)


@router.get(
    "/cells/{cell}/changes",
    response_model=dict[str, Any],
    responses=problem_responses(409),
)
async def get_changes(
    service: Context,
    _caller: Reader,
    cell: CellInPath,
    from_model: Annotated[str | None, Query(alias="from", max_length=40, pattern=r"^[A-Za-z0-9-]+$")] = None,
    to_model: Annotated[str | None, Query(alias="to", max_length=40, pattern=r"^[A-Za-z0-9-]+$")] = None,
    averaged: bool | None = None,
) -> dict[str, Any]:
    """Compare two models of the cell. For each parameter: changed, unchanged within ±x %, or cannot tell; for
    each cause: appeared, grew, shrank, unchanged, gone, or cannot tell.

    Default: the model in force against the one in force before it, the latter averaged with the accepted
    models before it that agree with it: smaller changes are found so. With `from`, exactly the two models
    named, unless `averaged=true`: then either is averaged with the accepted models before it that agree.
    """
    history = [a.model for a in await asyncio.to_thread(service.store.approvals, cell.id)]
    new = to_model or (history[0] if history else None)
    if from_model is not None:
        old: str | None = from_model
    else:
        earlier = history[history.index(new) + 1 :] if new in history else history
        old = next((m for m in earlier if m != new), None)
    if old is None or new is None:
        raise Problem(
            "no-comparison",
            f"cell {cell.id} has {len(set(history))} accepted model(s); name two models with ?from=…&to=…",
            simulated=cell.simulated,
        )
    before = await _stored_model(service, cell, old)
    after = await _stored_model(service, cell, new)
    if averaged is None:
        averaged = from_model is None
    result, sides = await asyncio.to_thread(
        service.results.changes, cell.id, before, after, averaged=averaged
    )
    found = {"cell": cell.id, "simulated": cell.simulated, "from": before.id, "to": after.id}
    return with_wording({**found, **changes_view(result, sides)})


@router.patch("/cells/{cell}/simulation", response_model=SimulationView, responses=problem_responses(409))
async def change_simulation(
    body: SimulationPatch, service: Context, caller: Runner, cell: CellInPath
) -> SimulationView:
    """Change the simulated cell (another tool, say) for the next run; one in progress is not affected."""
    if not cell.simulated:
        text = f"cell {cell.id} has hardware behind it; there is no simulation to change"
        raise Problem("not-simulated", text)
    try:
        # In a thread: the first use loads the simulated drives, and a stop must not wait for that.
        answer = await asyncio.to_thread(_change, cell, body)
    except InputError as error:
        raise Problem("invalid-request", str(error), simulated=True) from None
    facts = {"cell": cell.id, **body.model_dump(exclude_none=True)}
    await asyncio.to_thread(service.audit.try_write, "simulation", caller=caller.name, **facts)
    return answer


def _change(cell: Cell, body: SimulationPatch) -> SimulationView:
    if body.reset:
        cell.set_simulation(None)
    if body.payload is not None:
        cell.set_simulation(cell.with_payload(body.payload.axis, body.payload.mass))
    return SimulationView(cell=cell.id, simulation=cell.simulation)
