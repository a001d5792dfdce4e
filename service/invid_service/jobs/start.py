"""Starting an identification: the same answer for the same key, one run per cell, nothing lost."""

from __future__ import annotations

import asyncio
import hashlib
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from invid_service.cells.registry import Cell
from invid_service.jobs.protocol import Job
from invid_service.jobs.results import load
from invid_service.jobs.schema import StartBody
from invid_service.problems import Problem
from invid_service.service import Service
from invid_service.store.store import CellBusyError, KeyReusedError, RunRecord, StoredModel

_SIMULATED_TORQUE_NOISE = 0.005
"""Share of rated torque; as the case study, for a real cell simulated with its accepted model."""


async def start_identification(
    service: Service, cell_id: str, body: StartBody, caller: str, key: str | None
) -> RunRecord:
    """Queue a run, or return the one that the key stands for; Problem where neither is possible."""
    cell = service.cell(cell_id)
    digest = hashlib.sha256(body.model_dump_json().encode()).hexdigest()
    unknown = [a for a in body.axes or () if a not in cell.axes]
    if unknown:
        raise Problem(
            "invalid-request",
            f"axes: no axis {unknown[0][:64]!r}; the cell has {list(cell.axes)}",
            simulated=cell.simulated,
        )
    async with service.start_locks[cell.id]:
        if key is not None:
            try:
                earlier = await asyncio.to_thread(service.store.find_idempotent, cell.id, key, digest)
            except KeyReusedError:
                raise _reused(key, cell) from None
            if earlier is not None:
                return earlier
        await _refuse_if_not_ready(service, cell, body)
        record = service.new_run(cell, body.mode, list(body.axes or cell.axes), caller)
        in_force = await asyncio.to_thread(service.results.in_force, cell.id)
        job = _job(service, cell, record, body, in_force)
        live = service.jobs.reserve(record)
        try:
            facts = {"cell": cell.id, "identification": record.id, **body.model_dump()}
            await asyncio.to_thread(service.audit.write, "start", caller=caller, **facts)
            await asyncio.to_thread(service.store.add_run, record, idempotency_key=key, body_sha256=digest)
        except OSError as error:
            service.jobs.release(live)
            raise Problem("disk-full", f"the audit log cannot be written: {error.strerror}") from None
        except CellBusyError:
            service.jobs.release(live)
            raise Problem("run-in-progress", "another service runs this cell on the same database") from None
        except (SQLAlchemyError, asyncio.CancelledError):
            service.jobs.release(live)
            raise
        service.jobs.start(live, job)
        return record


def _reused(key: str, cell: Cell) -> Problem:
    return Problem(
        "idempotency-key-reused",
        f"Idempotency-Key {key!r} was used on this cell with another body; use a new key for a new request",
        simulated=cell.simulated,
    )


async def _refuse_if_not_ready(service: Service, cell: Cell, body: StartBody) -> None:
    ready = await service.readiness(cell, body.mode, axes=None if body.axes is None else tuple(body.axes))
    if ready.can_start:
        return
    members: dict[str, Any] = {
        "reasons": [r.model_dump() for r in ready.reasons],
        "simulated": cell.simulated,
    }
    detail = "; ".join(r.text for r in ready.reasons)
    busy = service.jobs.occupying(cell.id)
    if busy is not None:
        run = busy.record.id
        raise Problem(
            "run-in-progress",
            detail,
            {"Retry-After": "5"},
            identification=run,
            location=f"/api/v1/identifications/{run}",
            state=str(busy.record.state),
            **members,
        )
    raise Problem("not-ready", detail, **members)


def _job(
    service: Service, cell: Cell, record: RunRecord, body: StartBody, in_force: StoredModel | None
) -> Job:
    model = None if in_force is None else load(in_force)
    config = cell.job_config(int(record.id[-8:], 16) % 1_000_000)
    document = None
    if in_force is not None and model is not None:
        from invid.model.document import model_to_json

        document = model_to_json(model)
        if body.mode == "simulate" and not cell.simulated:
            config["bus"] = {
                **config["bus"],
                "interface": "invid-virtual",
                "channel": record.id,
                "options": {},
            }
            config["simulation"] = _simulation_of(document)
    return Job(
        id=record.id,
        kind="measure",
        mode=body.mode,
        folder=service.blobs.work / record.id,
        simulated=record.simulated,
        config=config,
        axes=body.axes,
        amplitude_scale=cell.config.safety.test_amplitude if body.mode == "test" else 1.0,
        arm=body.arm,
        acceptable=cell.simulated or body.mode != "simulate",
        model=document,
        memory_bytes=service.settings.worker_memory_bytes,
        stop_grace_s=service.settings.stop_grace_s,
    )


def _simulation_of(model: dict[str, Any]) -> dict[str, Any]:
    """A simulated plant with the parameters of a model."""
    return {
        "plant": {
            "branches": [
                {
                    "axis": b["axis"],
                    **{k: [e["value"] for e in b[k]] for k in ("masses", "springs", "dampers")},
                }
                for b in model["branches"]
            ],
            "couplings": [{"between": c["between"], "value": c["value"]} for c in model["couplings"]],
        },
        "defaults": {"torque_noise": _SIMULATED_TORQUE_NOISE},
        "effects": [
            {
                "cause": e["cause"],
                "axis": e["axis"],
                "element": e["element"],
                "other_axis": e["other_axis"],
                "parameters": {n: p["value"] for n, p in e["parameters"].items()},
            }
            for e in model["effects"]
        ],
    }
