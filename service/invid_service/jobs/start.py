"""Start an identification: the same answer for the same key, one run per cell, nothing lost."""

from __future__ import annotations

import asyncio
import hashlib
import json
from dataclasses import replace
from typing import Any

from invid.config import CellConfig
from invid.errors import InputError
from invid.model.document import model_to_json
from invid.planning.separating_experiments import Separation, to_separate
from invid_drivers.simulated.structure import CAUSES
from invid_drivers.values.closed_loop import closed_loop_config
from invid_service.cells.registry import Cell
from invid_service.jobs.protocol import Job
from invid_service.jobs.results import load
from invid_service.jobs.schema import StartBody
from invid_service.problems import Problem, storing
from invid_service.service import Service
from invid_service.store.store import CellBusyError, KeyReusedError, RunRecord, StoredModel

_SIMULATED_TORQUE_NOISE = 0.005
"""Share of rated torque; as the case study, for a real cell simulated with its accepted model."""


GENTLER = 0.5
"""Share of the planned torque of a run that is to be gentler."""
_RECENT = 20


async def begin_identification(
    service: Service, cell: Cell, body: StartBody, caller: str, key: str | None
) -> RunRecord:
    """Queue a run, or return the one that the key stands for; Problem where neither is possible."""
    digest = hashlib.sha256(body.model_dump_json().encode()).hexdigest()
    wrong = _wrong_with(body, cell)
    if wrong:
        raise Problem("invalid-request", wrong)
    async with service.start_locks[cell.id]:
        if key is not None:
            try:
                earlier = await asyncio.to_thread(service.store.find_idempotent, cell.id, key, digest)
            except KeyReusedError:
                text = f"Idempotency-Key {key!r} was used on this cell with another body; use a new key"
                raise Problem("idempotency-key-reused", f"{text} for a new request") from None
            if earlier is not None:
                return earlier
        await _refuse_if_not_ready(service, cell, body)
        separation = None if body.separate is None else await _separation(service, cell, body)
        tuning = None if body.tuned is None else await _tuning_of(service, body.tuned, cell)
        record = service.new_run(cell, body.mode, list(body.axes or cell.axes), caller)
        asked = body.model_dump(include={"amplitude", "changed"})
        record = replace(record, facts={**asked, "separates": body.separate, "verifies": body.tuned})
        in_force = await asyncio.to_thread(service.results.in_force, cell.id)
        job = _job(service, cell, record, body, in_force, separation)
        if tuning is not None and job.config is not None:
            closed = closed_loop_config(CellConfig.model_validate(job.config)).model_dump(mode="json")
            job = replace(job, config=closed, tuning=tuning)
        before = await asyncio.to_thread(_analysis_before, service, cell, body)
        facts = {"cell": cell.id, "identification": record.id, **body.model_dump()}
        with storing("the audit log", service.audit.path):
            await asyncio.to_thread(service.audit.write, "start", caller=caller, **facts)
        try:
            job = replace(job, expected_analysis_s=before)
            await service.jobs.begin(record, job, key=key, digest=digest)
        except CellBusyError:
            raise Problem("run-in-progress", "another service runs this cell on the same database") from None
        return record


def _wrong_with(body: StartBody, cell: Cell) -> str | None:
    """What of a body cannot be, on this cell."""
    unknown = [a for a in body.axes or () if a not in cell.axes]
    if body.separate is not None and body.axes is not None:
        return "axes: which axes move follows from what is to be separated; leave 'axes' out"
    if unknown:
        return f"axes: no axis {unknown[0][:64]!r}; the cell has {list(cell.axes)}"
    if body.mode == "screen" and (body.separate is not None or body.axes not in (None, list(cell.axes))):
        return "mode: a screening shakes all axes by a plan of its own; leave 'axes' and 'separate' out"
    if (body.tuned is None) == (body.mode == "verify") or (body.mode == "verify" and body.axes):
        return (
            "mode: 'verify' measures the loops of all axes, and 'tuned' names the run whose tuning the "
            "drives were given; nothing else takes 'tuned'"
        )
    return None if body.changed is None else body.changed.refusal(cell.axes, linear=cell.config.linear)


async def _tuning_of(service: Service, identity: str, cell: Cell) -> dict[str, Any]:
    """Return the tuning of a run (of ``cell``); Problem where there is none."""
    record, _ = await service.run(identity)
    if record.cell != cell.id:
        raise Problem("invalid-request", f"tuned: identification {identity} is not of cell {cell.id}")
    text = await asyncio.to_thread(_text_of, service, identity, "tuning")
    if text is None:
        raise Problem("wrong-state", f"identification {identity} was not tuned", simulated=record.simulated)
    document: dict[str, Any] = json.loads(text)
    return document


async def _refuse_if_not_ready(service: Service, cell: Cell, body: StartBody) -> None:
    axes = None if body.axes is None else tuple(body.axes)
    ready = await service.readiness(cell, body.mode, axes=axes)
    if ready.reasons and all(r.code == "check_refused" and r.seen for r in ready.reasons):
        # They refused when they were asked last; they may say otherwise now.
        ready, _ = await service.ask_drives(cell, body.mode, axes)
    if ready.can_start:
        return
    refusal = ready.problem()
    service.require_free_bus(cell, refusal.detail, **refusal.members)
    raise refusal


async def _separation(service: Service, cell: Cell, body: StartBody) -> Separation:
    """Return the experiments that separate the causes of an earlier run; Problem where there are none."""
    identity = body.separate or ""
    earlier, _ = await service.run(identity)
    if earlier.cell != cell.id:
        raise Problem("invalid-request", f"separate: identification {identity} is not of cell {cell.id}")
    text = await asyncio.to_thread(_text_of, service, identity, "diagnosis")
    if text is None:
        why = f"identification {identity} is {earlier.state} and has no diagnosis (any more)"
        raise Problem("nothing-to-separate", why)
    try:
        return to_separate(json.loads(text), cell.config)
    except (InputError, ValueError) as error:
        raise Problem("nothing-to-separate", str(error)) from None


def _text_of(service: Service, identity: str, kind: str) -> str | None:
    blob = service.store.artefacts(identity).get(kind)
    try:
        return None if blob is None else service.blobs.path(blob.path).read_text(encoding="utf-8")
    except OSError:
        return None


def _analysis_before(service: Service, cell: Cell, body: StartBody) -> float | None:
    """Return the seconds that the analysis of the cell's last runs took at most, in three of four cases; of
    runs like this one where there are any, of other cells with as many axes where it is the cell's first.
    """
    done: list[tuple[bool, float]] = []
    for which in (cell.id, None):
        for run in [] if done else service.store.runs(cell=which, limit=_RECENT, measured=True):
            took = (run.facts.get("summary") or {}).get("analysis_s")
            alike = run.mode == body.mode and (run.facts.get("separates") is None) == (body.separate is None)
            if took is not None and (which is not None or len(run.axes) == len(cell.axes)):
                done.append((alike, float(took)))
    took_s = sorted([took for alike, took in done if alike] or [took for _, took in done])
    return took_s[3 * (len(took_s) - 1) // 4] if took_s else None


def _job(
    service: Service,
    cell: Cell,
    record: RunRecord,
    body: StartBody,
    in_force: StoredModel | None,
    separation: Separation | None,
) -> Job:
    model = None if in_force is None else load(in_force)
    config = cell.job_config(int(record.id[-8:], 16) % 1_000_000)
    if separation is not None:
        other = separation.config.model_dump(mode="json")
        config = {**config, "experiments": other["experiments"]}
    full = cell.config.safety.test_amplitude if body.mode == "test" else 1.0
    document = None
    if in_force is not None and model is not None:
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
        requested_by=record.requested_by,
        folder=service.blobs.work / record.id,
        simulated=record.simulated,
        config=config,
        axes=body.axes,
        amplitude_scale=full * (GENTLER if body.amplitude == "gentler" else 1.0),
        amplitude=body.amplitude,
        purpose=None if separation is None else " ".join(separation.sentences),
        arm=body.arm,
        acceptable=cell.simulated or body.mode != "simulate",
        model=document,
        memory_bytes=service.settings.worker_memory_bytes,
        stop_grace_s=service.settings.stop_grace_s,
        budget_s=service.settings.analysis_budget_s,
    )


def _simulation_of(model: dict[str, Any]) -> dict[str, Any]:
    """Return a simulated plant with the parameters of a model, and those of its effects that it can have."""
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
            if e["cause"] in CAUSES  # not a law without a name, or a cause of a file
        ],
    }
