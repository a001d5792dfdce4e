"""Routes of the files of a run, and of its drawing: its branches with the findings and what changed."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse

from invid.comparison.numbers import name_of
from invid.errors import InvidError
from invid.model.diagnosis_document import Diagnosis, load_diagnosis, load_model
from invid.report.branch_drawing import branch_drawing
from invid.wording.sentence import Figure, sentence
from invid_service.dependencies import Context, FoundRun, Reader, RunInPath
from invid_service.problems import EVERYWHERE, Problem, problem_responses
from invid_service.service import Service
from invid_service.store.blobs import KINDS, Blob

router = APIRouter(tags=["identifications"], responses=EVERYWHERE)


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


async def stored_file(service: Service, run: FoundRun, kind: str) -> Path:
    """Return the stored file of a run; Problem 404 before it exists and 410 after its retention."""
    return (await _stored(service, run, kind))[1]


async def _stored(service: Service, run: FoundRun, kind: str) -> tuple[Blob, Path]:
    blobs = await asyncio.to_thread(service.store.artefacts, run.record.id)
    if kind not in blobs:
        raise run.problem("artefact-not-found", f" and has no {kind}")
    blob = blobs[kind]
    if blob is None:
        raise Problem("artefact-expired", f"the {kind} of {run.record.id} was deleted after its retention")
    path = service.blobs.path(blob.path)
    if not path.is_file():
        raise Problem("artefact-not-found", f"the {kind} of {run.record.id} is missing in the store")
    return blob, path


async def artefact(service: Service, run: FoundRun, kind: str, request: Request) -> Response:
    """Return the stored file of a run as an answer."""
    blob, path = await _stored(service, run, kind)
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
    return FileResponse(path, media_type=media, headers=headers, filename=f"{run.record.id}-{name}")


def _offer_file(kind: str, operation: str, text: str) -> None:
    """Add the route of one of the stored files of a run."""

    async def get(request: Request, service: Context, _caller: Reader, run: RunInPath) -> Response:
        return await artefact(service, run, kind, request)

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


@router.get(
    "/identifications/{identification}/drawing",
    response_class=Response,
    responses={
        **problem_responses(410),
        200: {"description": "SVG", "content": {"image/svg+xml": {"schema": {"type": "string"}}}},
    },
)
async def get_drawing(
    service: Context,
    _caller: Reader,
    run: RunInPath,
    lang: Annotated[Literal["en", "de"], Query(description="Language of its words")] = "en",
) -> Response:
    """Return the branches of the identified model as a picture: numbers, changes and each finding at its
    place.
    """
    paths = {"model": await stored_file(service, run, "model")}
    with contextlib.suppress(Problem):  # it is drawn without, too
        paths["diagnosis"] = await stored_file(service, run, "diagnosis")
    changes = (run.record.facts.get("summary") or {}).get("changes")
    try:
        svg = await asyncio.to_thread(_drawn, paths["model"], paths.get("diagnosis"), changes, lang)
    except InvidError as error:
        raise Problem(
            "artefact-not-found", f"the model of {run.record.id} cannot be drawn: {error}"
        ) from None
    return Response(svg, media_type="image/svg+xml", headers={"Cache-Control": "private, no-cache"})


def _drawn(model: Path, diagnosis: Path | None, changes: Mapping[str, Any] | None, lang: str) -> str:
    found: Diagnosis | None = None
    if diagnosis is not None:
        with contextlib.suppress(InvidError):  # the model is drawn all the same
            found = load_diagnosis(diagnosis)
    return branch_drawing(
        load_model(model),
        () if found is None else found.findings,
        None if found is None else found.unexplained,
        changed=changed_parameters(changes),
        news={} if found is None else _news(found, changes),
        language=lang,
    )


def changed_parameters(changes: Mapping[str, Any] | None) -> dict[str, str]:
    """Return the change ("+12 %") of each changed parameter by name, from the body of ``GET
    /cells/{cell}/changes``.
    """
    found = dict[str, str]()
    for p in (changes or {}).get("parameters", []):
        old = (p.get("from") or {}).get("value")
        if p.get("status") != "changed" or p.get("difference") is None:
            continue
        share = p["difference"] / abs(old) if old else math.nan
        sign = "+" if p["difference"] > 0 else "−"
        size = f"{sign}{abs(100 * share):.2g} %" if math.isfinite(share) and abs(share) < 10 else sign
        found[p["parameter"]] = Figure(size)
    return found


_NEWS = {"appeared": sentence("new"), "grew": sentence("grown"), "shrank": sentence("smaller")}


def _news(found: Diagnosis, changes: Mapping[str, Any] | None) -> dict[int, str]:
    """Return a word for each finding that came, grew or shrank since the model in force."""
    status = {c.get("name"): c.get("status") for c in (changes or {}).get("causes", [])}
    said = {n: _NEWS.get(str(status.get(name_of(f.effect)))) for n, f in enumerate(found.findings, 1)}
    return {n: word for n, word in said.items() if word is not None}
