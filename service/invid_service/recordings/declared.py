"""What an uploaded HDF5 file claims to hold, read in a process of its own before anything is unpacked.

A few hundred kilobytes can unpack to gigabytes, and the library that reads them is not made for files of
strangers: ``claims`` runs ``python -m invid_service.recordings.declared FILE`` with little memory and time,
which opens the file and adds up the declared sizes, chunk by chunk, decoding nothing.
"""

from __future__ import annotations

import asyncio
import json
import resource
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from invid_service.problems import Problem

_MEMORY = 2 * 1024**3
"""Address space of that process; Python, numpy and HDF5 map half a gigabyte."""
_CPU_S = 20
_PATIENCE_S = 120.0
"""A busy machine takes seconds to start a process."""
_NUMBER = 8
"""Bytes of one number once read: everything becomes float64."""
SMALL = 64 * 1024**2
"""Below this no ratio is asked for: a short record of axes that stand still packs as well as it likes."""
RATIO = 100.0
"""Largest ratio of unpacked to stored bytes. Encoders and torque sensors have noise, which does not pack:
measured and simulated recordings come to 2 to 10; what unpacks to a hundred times its size is empty."""


class Claim(BaseModel):
    """``problem`` says why the file is no recording, or ``unpacked`` how large it gets [bytes]."""

    problem: str | None = None
    unpacked: int = 0


async def check_claims(path: Path, *, largest: int) -> None:
    """Problem where the file is no HDF5 recording, or unpacks to more than ``largest`` bytes."""
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
    """Look at the file from another process."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        __name__,
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


def look(path: Path) -> Claim:
    """What the file claims; nothing in it is unpacked."""
    import h5py

    damaged = Claim(problem="the HDF5 file is damaged or truncated; copy it again from where it was written")
    try:
        with h5py.File(path, "r") as file:
            form: Any = file.attrs.get("format")
            form = form.decode("utf-8", "replace") if isinstance(form, bytes) else form
            if form != "invid-recording":
                text = f"the HDF5 file has format {str(form)[:64]!r}, not 'invid-recording'"
                return Claim(problem=f"{text}; 'invid import' turns other files into one")
            group = file.get("experiments")
            unpacked = 0
            for node in group.values() if isinstance(group, h5py.Group) else ():
                if isinstance(node, h5py.Group):
                    unpacked += sum(_unpacked(d) for d in node.values() if isinstance(d, h5py.Dataset))
            return Claim(unpacked=unpacked)
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError):
        return damaged


def _unpacked(data: Any) -> int:
    """Bytes that reading takes: whole chunks, which may be larger than what they are said to hold."""
    shape, chunks = data.shape or (), data.chunks
    whole = [-(-n // c) * c for n, c in zip(shape, chunks, strict=True)] if chunks else shape
    count = 1
    for n in whole:
        count *= int(n)
    return count * max(_NUMBER, int(data.dtype.itemsize))


def main() -> None:
    """Entry of the process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    print(json.dumps(look(Path(sys.argv[1])).model_dump()))


if __name__ == "__main__":
    main()
