"""Route ``POST /recordings``: data from elsewhere, identified and diagnosed with no drive involved."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from invid.model.document import parse_json
from invid_service.cells.registry import Cell
from invid_service.dependencies import Context, RunInPath, Runner
from invid_service.jobs.files import stored_file
from invid_service.jobs.protocol import Job
from invid_service.jobs.schema import Identification, following, view
from invid_service.jobs.states import OCCUPYING, UPLOAD
from invid_service.openapi import ACCEPTED
from invid_service.problems import EVERYWHERE, Problem, problem_responses, storing
from invid_service.recordings.claims import check_claims
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
    """
    media = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if media not in (*_RAW, "multipart/form-data"):
        raise Problem(
            "unsupported-media-type",
            f"Content-Type {media!r}: send the HDF5 file as application/x-hdf5 or as the form field 'file'",
        )
    if cell is not None:
        service.cell(cell)
    _require_room(service, int(request.headers.get("content-length") or 0))
    record = service.new_run(None, UPLOAD, [], caller.name)
    with service.blobs.filling(record.id) as folder:
        target = folder / "recording.h5"
        if media in _RAW:
            await _receive_raw(request, target)
        else:
            cell = await _receive_form(request, target, cell)
        owner = None if cell is None else service.cell(cell)
        await check_claims(target, largest=service.settings.max_unpacked_bytes)
        if owner is not None:
            record = replace(record, cell=owner.id, robot=owner.config.robot)
        await _queue(service, record, folder, owner)
    response.headers.update(following(record.id))
    return view(record, service.jobs.live(record.id))


def _require_room(service: Service, wanted: int = 0) -> None:
    if service.blobs.free_bytes() < service.settings.min_free_bytes + wanted:
        raise Problem("disk-full", "there is not enough room on the service's disk for this recording")


@router.post(
    "/identifications/{identification}/analysis",
    status_code=202,
    response_model=Identification,
    responses={**ACCEPTED, **problem_responses(409, 410, 507)},
)
async def analyse_identification(
    response: Response, service: Context, caller: Runner, run: RunInPath
) -> Identification:
    """Identify and diagnose the recording of a run that has ended, as if it had been uploaded.

    For a run that was stopped, failed or was interrupted: what it measured until then is worked out, or the
    new run's ``error`` says what is missing.
    """
    earlier = run.record
    if earlier.state in OCCUPYING:
        raise run.problem("wrong-state", "; its recording is analysed once it has ended")
    source = await stored_file(service, run, "recording")
    _require_room(service)
    record = service.new_run(None, UPLOAD, list(earlier.axes), caller.name)
    facts = {"analyses": earlier.id}
    record = replace(record, cell=earlier.cell, robot=earlier.robot, simulated=earlier.simulated, facts=facts)
    with service.blobs.filling(record.id) as folder:
        with storing("the copy of the recording", folder / "recording.h5"):
            await asyncio.to_thread(_same_file, source, folder / "recording.h5")
        await _queue(service, record, folder, service.cells.get(earlier.cell or ""))
    response.headers.update(following(record.id))
    return view(record, service.jobs.live(record.id))


def _same_file(source: Path, target: Path) -> None:
    """Make a second name of a file that nobody changes any more, or a copy."""
    try:
        target.hardlink_to(source)
    except OSError:
        shutil.copyfile(source, target)


async def _receive_raw(request: Request, target: Path) -> None:
    first = b""
    with storing("the upload", target), target.open("wb") as file, _whole():
        async for chunk in request.stream():
            first = first if len(first) >= len(SIGNATURE) else (first + chunk)[: len(SIGNATURE)]
            _require_hdf5(first, SIGNATURE[: len(first)])
            await asyncio.to_thread(file.write, chunk)
    _require_hdf5(first, SIGNATURE)


@contextlib.contextmanager
def _whole() -> Iterator[None]:
    """Problem where the sender hangs up within."""
    try:
        yield
    except ClientDisconnect:
        raise Problem("bad-request", "the upload was cut off; send it again") from None


def _require_hdf5(first: bytes, signature: bytes) -> None:
    if first != signature:
        text = "the body is no HDF5 file; 'invid import' turns other formats into one"
        raise Problem("invalid-recording", text)


async def _receive_form(request: Request, target: Path, cell: str | None) -> str | None:
    """Write the file of a form; return the cell that form or query (``cell``) names."""
    # Files are spooled to disk beyond a megabyte: memory does not grow with the upload.
    try:
        with _whole():
            form = await request.form(max_files=1, max_fields=4, max_part_size=4096)
    except HTTPException as error:
        if error.status_code == 400:
            raise Problem("invalid-request", f"the form cannot be read: {error.detail}") from None
        raise
    try:
        return await _read_form(form, target, cell)
    finally:
        await form.close()


async def _read_form(form: FormData, target: Path, cell: str | None) -> str | None:
    file, named = form.get("file"), form.get("cell") or cell
    if not isinstance(file, UploadFile):
        raise Problem("invalid-request", "the form has no file in the field 'file'")
    _require_hdf5(await file.read(len(SIGNATURE)), SIGNATURE)
    if not isinstance(named, str | None) or cell not in (None, named):
        raise Problem("invalid-request", f"cell: the query says {cell!r}, the form {str(named)[:64]!r}")
    await file.seek(0)
    with storing("the upload", target), target.open("wb") as out:
        await asyncio.to_thread(shutil.copyfileobj, file.file, out, 1024 * 1024)
    return named


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
        model=None if accepted is None else parse_json(accepted.document),
        memory_bytes=service.settings.worker_memory_bytes,
        stop_grace_s=service.settings.stop_grace_s,
        budget_s=service.settings.analysis_budget_s,
    )
    await service.jobs.begin(record, job)
