"""Check what an uploaded HDF5 file claims to hold, in a process of its own before anything is unpacked.

A few hundred kilobytes can unpack to gigabytes, and the library that reads them is not made for files of
strangers: ``claims`` has another process (``declared``) look at it with little memory and time.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from pydantic import BaseModel, ValidationError

from invid_service.problems import Problem

_PATIENCE_S = 120.0
"""A busy machine takes seconds to start a process."""
SMALL = 64 * 1024**2
"""Below this no ratio is asked for: a short record of axes that stand still packs as well as it likes."""
RATIO = 100.0
"""Largest ratio of unpacked to stored bytes. Encoders and torque sensors have noise, which does not pack:
of 201 recordings measured and simulated here none exceeds 3. What unpacks to a hundred times its size is
empty."""


class Claim(BaseModel):
    """Answer of the process: ``problem`` says why the file is no recording, or ``unpacked`` its size
    [bytes].
    """

    problem: str | None = None
    unpacked: int = 0


async def check_claims(path: Path, *, largest: int) -> None:
    """Raise a problem where the file is no HDF5 recording, or unpacks to more than ``largest`` bytes."""
    claim = await claims(path)
    if claim.problem is not None:
        raise Problem("invalid-recording", claim.problem)
    stored = path.stat().st_size
    megabytes = f"{stored / 1e6:.1f} MB unpack to {claim.unpacked / 1e6:.0f} MB"
    if claim.unpacked > largest:
        raise Problem(
            "too-large", f"the recording's {megabytes}; at most {largest / 1e6:.0f} MB are read: cut it"
        )
    if claim.unpacked > SMALL and claim.unpacked > RATIO * stored:
        raise Problem(
            "too-large",
            f"the recording's {megabytes}, {claim.unpacked / stored:.0f} times its size, which no measured "
            f"data do; store it without compression if it is one",
        )


async def claims(path: Path) -> Claim:
    """Return what the file claims, looked at by another process."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "invid_service.recordings.declared",
        str(path),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    try:
        async with asyncio.timeout(_PATIENCE_S):
            said, _ = await process.communicate()
        return Claim.model_validate_json(said)
    except (TimeoutError, ValidationError):
        return Claim(problem="the HDF5 file cannot be opened: it is damaged, or made to be hard to read")
    finally:
        if process.returncode is None:
            process.kill()
