"""Start the runner process and talk to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Protocol

from pydantic import ValidationError

from invid_service.jobs.protocol import TOLD, Job, Told, Wish

log = logging.getLogger(__name__)
_LINE_LIMIT = 16 * 1024 * 1024


class Worker(Protocol):
    """Protocol of a running job, whatever process or double runs it."""

    async def send(self, wish: Wish) -> None:
        """Tell the runner what is wished; nothing happens where it is gone."""

    def messages(self) -> AsyncIterator[Told]:
        """Yield what the runner says, until it ends."""

    def kill(self) -> None:
        """End the process now."""

    async def wait(self) -> int:
        """Return the exit status, once it has ended."""


Launcher = Callable[[Job], Awaitable[Worker]]


class ProcessWorker:
    """Runner as a process of its own session: a Ctrl-C meant for the service does not reach it."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Return the process id."""
        return self._process.pid

    async def send(self, wish: Wish) -> None:
        """Write one line to the runner."""
        await self.write(json.dumps({"type": wish}))

    async def write(self, line: str) -> None:
        """Write one line of JSON."""
        pipe = self._process.stdin
        if pipe is None or pipe.is_closing():
            return
        with contextlib.suppress(ConnectionError, OSError):
            pipe.write(line.encode() + b"\n")
            await pipe.drain()

    async def messages(self) -> AsyncIterator[Told]:
        """Yield what the lines say; one that is not of the protocol is passed over."""
        pipe = self._process.stdout
        while pipe is not None:
            try:
                line = await pipe.readline()
            except ValueError:  # longer than the limit: not of our protocol
                continue
            if not line:
                return
            try:
                message = TOLD.validate_json(line)
            except ValidationError as error:
                log.warning("runner %d: %s", self.pid, error)
                continue
            yield message

    def kill(self) -> None:
        """End the process now (SIGKILL)."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    async def wait(self) -> int:
        """Return the exit status."""
        return await self._process.wait()


async def launch_process(job: Job) -> ProcessWorker:
    """Start ``invid_service.jobs.worker`` and hand it the job."""
    job.folder.mkdir(parents=True, exist_ok=True)
    log = _open_log(job.folder / "worker.log")
    try:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "invid_service.jobs.worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=log,
            limit=_LINE_LIMIT,
            start_new_session=True,
            env=one_thread(),
        )
    finally:
        os.close(log)
    worker = ProcessWorker(process)
    await worker.write(job.model_dump_json())
    return worker


def one_thread() -> dict[str, str]:
    """The environment of a process that computes on one thread."""
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _open_log(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
