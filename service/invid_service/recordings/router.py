"""Route ``POST /recordings``: data from elsewhere, identified and diagnosed with no drive involved."""

from __future__ import annotations

import asyncio
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from invid_service.auth import Runner
from invid_service.cells.registry import Cell
from invid_service.context import Context
from invid_service.jobs.protocol import Job
from invid_service.jobs.router import stored_file
from invid_service.jobs.schema import RETRY_AFTER_S, Identification, view
from invid_service.jobs.states import OCCUPYING, UPLOAD
from invid_service.links import address
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, Problem, not_stored, problem_responses
from invid_service.recordings.claims import check_claims
from invid_service.recordings.simulator import LARGEST, checked_simulator
from invid_service.service import Service
from invid_service.store.store import RunRecord

router = APIRouter(tags=["recordings"], responses=EVERYWHERE)

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_RAW = ("application/x-hdf5", "application/x-hdf", "application/octet-stream")
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            **{media: {"schema": {"type": "string", "format": "binary"}} for media in _RAW},
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {
                        "file": {"type": "string", "format": "binary"},
                        "cell": {"type": "string"},
                        "simulator": {"type": "string", "format": "binary"},
                    },
                }
            },
        },
    }
}


@router.post(
    "/recordings",
    status_code=202,
    response_model=Identification,
    responses={**ACCEPTED, **problem_responses(408, 415, 507)},
    openapi_extra=_BODY,
)
async def upload_recording(
    request: Request,
    response: Response,
    service: Context,
    caller: Runner,
    cell: Annotated[str | None, Query(max_length=64, pattern=r"^[A-Za-z0-9_-]+$")] = None,
) -> Identification:
    """Upload an ``invid-recording`` (HDF5), as the body itself or as the form field ``file``.

    ``cell``, in the query or as a field of the form: the result belongs to the history of that cell, whose
    axes it must have. It is no measurement of it, so it blocks no run and is never in force.

    ``simulator``, a field of the form: a MuJoCo XML, a URDF or an ``invid-model``, run by its own engine on
    the records kept out. The diagnosis then has ``against``; the corrected copy is at the link ``corrected``.
    It is one file that reads no other; an FMU is native code and is refused.
    """
    owner = None if cell is None else service.cell(cell)
    media = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if media not in (*_RAW, "multipart/form-data"):
        raise Problem(
            "unsupported-media-type",
            f"Content-Type {media!r}: send the HDF5 file as application/x-hdf5 or as the form field 'file'",
        )
    announced = int(request.headers.get("content-length") or 0)
    if service.blobs.free_bytes() < service.settings.min_free_bytes + announced:
        raise Problem("disk-full", "there is not enough room on the service's disk for this upload")
    record = service.new_run(None, UPLOAD, [], caller.name)
    folder = service.blobs.scratch(record.id)
    try:
        target = folder / "recording.h5"
        if media == "multipart/form-data":
            named, simulator = await _receive_form(request, target)
            if simulator is not None:
                suffix, text = await asyncio.to_thread(checked_simulator, simulator)
                record = replace(record, facts={**record.facts, "simulator": f"simulator{suffix}"})
                await asyncio.to_thread(_write, folder / f"simulator{suffix}", text)
            if named is not None:
                if cell not in (None, named):
                    raise Problem(
                        "invalid-request", f"cell: the query says {cell!r}, the form {named[:64]!r}"
                    )
                owner = service.cell(named)
        else:
            await _receive_raw(request, target)
        await check_claims(target, largest=service.settings.max_unpacked_bytes)
        if owner is not None:
            record = replace(record, cell=owner.id, robot=owner.config.robot)
        await _queue(service, record, folder, owner)
    except BaseException:
        service.blobs.clear_scratch(record.id)
        raise
    response.headers["Location"] = address("identifications", record.id)
    response.headers["Retry-After"] = str(RETRY_AFTER_S)
    return view(record, service.jobs.live(record.id))


@router.post(
    "/identifications/{identification}/analysis",
    status_code=202,
    response_model=Identification,
    responses={**ACCEPTED, **problem_responses(409, 410, 507)},
)
async def analyse_identification(
    identification: str, response: Response, service: Context, caller: Runner
) -> Identification:
    """Identify and diagnose the recording of a run that has ended, as if it had been uploaded.

    For a run that was stopped, failed or was interrupted: what it measured until then is worked out, or the
    new run's ``error`` says what is missing.
    """
    earlier, _ = await service.run(identification)
    if earlier.state in OCCUPYING:
        raise Problem(
            "wrong-state",
            f"identification {earlier.id} is {earlier.state}; its recording is analysed once it has ended",
            state=str(earlier.state),
            simulated=earlier.simulated,
        )
    source = await stored_file(service, earlier, "recording")
    if service.blobs.free_bytes() < service.settings.min_free_bytes:
        raise Problem("disk-full", "there is not enough room on the service's disk for an analysis")
    record = service.new_run(None, UPLOAD, list(earlier.axes), caller.name)
    facts = {"analyses": earlier.id}
    record = replace(record, cell=earlier.cell, robot=earlier.robot, simulated=earlier.simulated, facts=facts)
    folder = service.blobs.scratch(record.id)
    try:
        await asyncio.to_thread(_same_file, source, folder / "recording.h5")
        await _queue(service, record, folder, service.cells.get(earlier.cell or ""))
    except BaseException:
        service.blobs.clear_scratch(record.id)
        raise
    response.headers["Location"] = address("identifications", record.id)
    response.headers["Retry-After"] = str(RETRY_AFTER_S)
    return view(record, service.jobs.live(record.id))


def _same_file(source: Path, target: Path) -> None:
    """Make a second name of a file that nobody changes any more, or a copy."""
    try:
        target.hardlink_to(source)
    except OSError:
        try:
            shutil.copyfile(source, target)
        except OSError as error:
            raise not_stored("the copy of the recording", target, error) from None


async def _receive_raw(request: Request, target: Path) -> None:
    first = b""
    try:
        with target.open("wb") as file:
            async for chunk in request.stream():
                if len(first) < len(SIGNATURE):
                    first += chunk[: len(SIGNATURE) - len(first)]
                    if not SIGNATURE.startswith(first):
                        raise _no_recording()
                await asyncio.to_thread(file.write, chunk)
    except ClientDisconnect:
        raise Problem("bad-request", "the upload was cut off; send it again") from None
    except OSError as error:
        raise not_stored("the upload", target, error) from None
    if first != SIGNATURE:
        raise _no_recording()


def _no_recording() -> Problem:
    return Problem(
        "invalid-recording", "the body is no HDF5 file; 'invid import' turns other formats into one"
    )


async def _receive_form(request: Request, target: Path) -> tuple[str | None, bytes | None]:
    """Write the file of a form; return the cell that the form names, and the simulator's bytes."""
    # Files are spooled to disk beyond a megabyte: memory does not grow with the upload.
    try:
        form = await request.form(max_files=2, max_fields=4, max_part_size=4096)
    except ClientDisconnect:
        raise Problem("bad-request", "the upload was cut off; send it again") from None
    except HTTPException as error:
        if error.status_code == 400:
            raise Problem("invalid-request", f"the form cannot be read: {error.detail}") from None
        raise
    try:
        file = form.get("file")
        if not isinstance(file, UploadFile):
            raise Problem("invalid-request", "the form has no file in the field 'file'")
        if (await file.read(len(SIGNATURE))) != SIGNATURE:
            raise _no_recording()
        await file.seek(0)
        await asyncio.to_thread(_copy, file, target)
        named, simulator = form.get("cell"), form.get("simulator")
        if simulator is not None and not isinstance(simulator, UploadFile):
            raise Problem("invalid-request", "simulator: send the file itself, as the recording in 'file'")
        model = None if simulator is None else await simulator.read(LARGEST + 1)
        return named if isinstance(named, str) and named else None, model
    finally:
        await form.close()


def _copy(file: UploadFile, target: Path) -> None:
    try:
        with target.open("wb") as out:
            shutil.copyfileobj(file.file, out, 1024 * 1024)
    except OSError as error:
        raise not_stored("the upload", target, error) from None


def _write(target: Path, text: bytes) -> None:
    try:
        target.write_bytes(text)
    except OSError as error:
        raise not_stored("the simulator", target, error) from None


async def _queue(service: Service, record: RunRecord, folder: Path, cell: Cell | None) -> None:
    accepted = None if cell is None else await asyncio.to_thread(service.results.in_force, cell.id)
    job = Job(
        id=record.id,
        kind="analyse",
        mode=UPLOAD,
        requested_by=record.requested_by,
        folder=folder,
        simulated=False,
        config=None if cell is None else cell.config.model_dump(mode="json"),
        acceptable=False,
        model=None if accepted is None else json.loads(accepted.document),
        simulator=record.facts.get("simulator"),
        memory_bytes=service.settings.worker_memory_bytes,
        stop_grace_s=service.settings.stop_grace_s,
        budget_s=service.settings.analysis_budget_s,
    )
    live = service.jobs.reserve(record)
    try:
        await asyncio.to_thread(service.store.add_run, record)
    except (SQLAlchemyError, asyncio.CancelledError):
        service.jobs.release(live)
        raise
    service.jobs.start(live, job)
