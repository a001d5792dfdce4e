"""Draw the branches of a result with its findings and what changed since the model in force."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Response

from invid.comparison.numbers import name_of
from invid.errors import InvidError
from invid.model.diagnosis_document import Diagnosis, load_diagnosis, load_model
from invid.report.branch_drawing import branch_drawing
from invid_service.auth import Reader
from invid_service.context import Context
from invid_service.problems import EVERYWHERE, Problem, problem_responses
from invid_service.query import refuse_unknown_parameters
from invid_service.web.texts import catalogue, drawing_words

router = APIRouter(
    tags=["identifications"], responses=EVERYWHERE, dependencies=[Depends(refuse_unknown_parameters)]
)


@router.get(
    "/identifications/{identification}/drawing",
    response_class=Response,
    responses={
        **problem_responses(410),
        200: {"description": "SVG", "content": {"image/svg+xml": {"schema": {"type": "string"}}}},
    },
)
async def get_drawing(
    identification: str,
    service: Context,
    _caller: Reader,
    lang: Annotated[Literal["en", "de"], Query(description="Language of its words")] = "en",
) -> Response:
    """Return the branches of the identified model as a picture: numbers, changes and each finding at its
    place.
    """
    record, _ = await service.run(identification)
    blobs = await asyncio.to_thread(service.store.artefacts, record.id)
    if "model" not in blobs:
        raise Problem(
            "artefact-not-found",
            f"identification {record.id} is {record.state} and has no model to draw",
            state=str(record.state),
            simulated=record.simulated,
        )
    paths: dict[str, Path] = {}
    for kind in ("model", "diagnosis"):
        blob = blobs.get(kind)
        if blob is not None:
            paths[kind] = service.blobs.path(blob.path)
    if "model" not in paths:
        raise Problem("artefact-expired", f"the model of {record.id} was deleted after its retention")
    changes = (record.facts.get("summary") or {}).get("changes")
    try:
        svg = await asyncio.to_thread(_drawn, paths["model"], paths.get("diagnosis"), changes, lang)
    except InvidError as error:
        raise Problem("artefact-not-found", f"the model of {record.id} cannot be drawn: {error}") from None
    return Response(svg, media_type="image/svg+xml", headers={"Cache-Control": "private, no-cache"})


def _drawn(model: Path, diagnosis: Path | None, changes: Mapping[str, Any] | None, lang: str) -> str:
    found: Diagnosis | None = None
    if diagnosis is not None:
        try:
            found = load_diagnosis(diagnosis)
        except InvidError:  # the model is drawn all the same
            found = None
    texts = catalogue(lang)
    return branch_drawing(
        load_model(model),
        () if found is None else found.findings,
        None if found is None else found.unexplained,
        changed=changed_parameters(changes, texts["number.point"]),
        news={} if found is None else _news(found, changes, texts),
        words=drawing_words(lang),
    )


def changed_parameters(changes: Mapping[str, Any] | None, point: str = ".") -> dict[str, str]:
    """Return the change ("+12 %") of each changed parameter by name, from the body of ``GET
    /cells/{cell}/changes``.
    """
    found = {}
    for p in (changes or {}).get("parameters", []):
        old = (p.get("from") or {}).get("value")
        if p.get("status") != "changed" or p.get("difference") is None:
            continue
        share = p["difference"] / abs(old) if old else math.nan
        sign = "+" if p["difference"] > 0 else "−"
        size = f"{sign}{abs(100 * share):.2g} %" if math.isfinite(share) and abs(share) < 10 else sign
        found[p["parameter"]] = size.replace(".", point)
    return found


def _news(found: Diagnosis, changes: Mapping[str, Any] | None, texts: Mapping[str, str]) -> dict[int, str]:
    """Return a word for each finding that came, grew or shrank since the model in force."""
    status = {c.get("name"): c.get("status") for c in (changes or {}).get("causes", [])}
    words = {s: texts[f"drawing.{s}"] for s in ("appeared", "grew", "shrank")}
    said = {n: words.get(str(status.get(name_of(f.effect)))) for n, f in enumerate(found.findings, 1)}
    return {n: word for n, word in said.items() if word is not None}
