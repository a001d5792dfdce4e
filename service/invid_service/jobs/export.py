"""Export the identified model for another tool: ``invid export`` in a process of its own, its file
handed on.
"""

from __future__ import annotations

import asyncio
import json
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse

from invid_service.auth import Reader
from invid_service.context import Context
from invid_service.jobs.router import artefact
from invid_service.links import address
from invid_service.problems import EVERYWHERE, Problem, problem_responses

MEDIA = {
    "statespace": ("mat", "application/x-matlab-data"),
    "mjcf": ("xml", "application/xml"),
    "urdf": ("urdf", "application/xml"),
    "fmu": ("fmu", "application/zip"),
}
"""Format -> (ending, media type)."""
PATIENCE_S = 60.0
AT_ONCE = 2
"""Exports at once: each is a process of some seconds."""


def export_router() -> APIRouter:
    """Return the router of ``GET /identifications/{identification}/export``."""
    router = APIRouter(tags=["identifications"], responses=EVERYWHERE)
    room = asyncio.Semaphore(AT_ONCE)

    @router.get(
        "/identifications/{identification}/export",
        response_class=Response,
        responses={
            **problem_responses(410, 501),
            200: {
                "description": "The file; with `beside`, its covariance and losses",
                "content": {
                    **{m: {"schema": {"type": "string", "format": "binary"}} for _, m in MEDIA.values()},
                    "application/json": {"schema": {"type": "object"}},
                },
            },
        },
    )
    async def export_model(
        identification: str,
        request: Request,
        service: Context,
        _caller: Reader,
        to: Annotated[Literal["statespace", "mjcf", "urdf", "fmu"], Query()],
        beside: Annotated[
            bool, Query(description="Instead of the file: covariance, and what the file does not hold")
        ] = False,
    ) -> Response:
        """Return the model as a MAT file (state space), for MuJoCo, as URDF or FMU (FMI 3).

        What the format cannot hold stands in the document that ``beside=true`` gets; ``Link`` names it.
        """
        stored = await artefact(service, identification, "model", request)
        if not isinstance(stored, FileResponse):
            raise Problem("artefact-not-found", f"the model of {identification} was not read")
        record, _ = await service.run(identification)
        ending, media = MEDIA[to]
        with tempfile.TemporaryDirectory(prefix="invid-export-") as folder:
            made = Path(folder) / f"model.{ending}"
            async with room:
                await _run(Path(stored.path), to, made)
            if beside:
                document = json.loads(made.with_name(f"{made.name}.json").read_text(encoding="utf-8"))
                document["simulated"] = record.simulated
                return Response(json.dumps(document, ensure_ascii=False), media_type="application/json")
            content = made.read_bytes()
        link = f"{address('identifications', record.id, 'export')}?to={to}&beside=true"
        headers = {
            "Content-Disposition": f'attachment; filename="{record.id}.{ending}"',
            "Cache-Control": "private, no-cache",
            "Link": f'<{link}>; rel="describedby"',
        }
        return Response(content, media_type=media, headers=headers)

    return router


async def _run(model: Path, to: str, made: Path) -> None:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "invid", "export", str(model), "--to", to, "-o", str(made), "--json"),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        async with asyncio.timeout(PATIENCE_S):
            _, said = await process.communicate()
    except TimeoutError:
        raise Problem("export-unavailable", f"--to {to} took longer than {PATIENCE_S:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
    if process.returncode != 0:
        # The command's one message names the package that is missing, or what the model lacks.
        message = said.decode("utf-8", "replace").strip().rpartition("\n")[2].removeprefix("invid: ")
        raise Problem("export-unavailable", message.replace(str(model), "the model"))
