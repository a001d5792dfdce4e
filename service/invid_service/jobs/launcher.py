"""Start processes that work for the service, and follow them on its event loop."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any, Protocol

from invid_drivers.protocol import Process, Stop, launch
from invid_service.jobs.protocol import Arm, Job, Told

log = logging.getLogger(__name__)


class Worker(Protocol):
    """Protocol of a running job, whatever process or double runs it."""

    def send(self, wish: Arm | Stop) -> None:
        """Tell the runner what is wished; nothing happens where it is gone."""

    def messages(self) -> AsyncIterator[Told]:
        """Yield what the runner says, until it ends."""

    def kill(self) -> None:
        """End the process now."""

    async def wait(self) -> int:
        """Return the exit status, once it has ended."""


Launcher = Callable[[Job], Awaitable[Worker]]


class ProcessWorker:
    """A process of its own session: a Ctrl-C meant for the service does not reach it."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._loop = asyncio.get_running_loop()
        self._said: asyncio.Queue[Any] = asyncio.Queue()
        self._status: asyncio.Future[int] = self._loop.create_future()
        threading.Thread(target=self._read, name="reader", daemon=True).start()

    @classmethod
    async def start(cls, module: str, task: object, printed: Path) -> ProcessWorker:
        """Start a module in a process and hand it its task; what it prints goes to a file."""
        return cls(await asyncio.to_thread(_launch, module, task, printed))

    def _read(self) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody wants to know
            try:
                while True:
                    self._loop.call_soon_threadsafe(self._said.put_nowait, self._process.connection.recv())
            except (EOFError, OSError):
                pass
            except Exception as error:  # half a message, or none of ours
                log.warning("process %d: %s", self._process.child.pid, error)
            self._loop.call_soon_threadsafe(self._said.put_nowait, None)
            self._loop.call_soon_threadsafe(self._end, self._process.child.wait())

    def _end(self, status: int) -> None:
        if not self._status.done():
            self._status.set_result(status)

    def send(self, wish: Arm | Stop) -> None:
        """Tell it what is wished."""
        self._process.send(wish)

    async def messages(self) -> AsyncIterator[Any]:
        """Yield what it says, until it ends."""
        while (message := await self._said.get()) is not None:
            yield message

    def kill(self) -> None:
        """End the process now (SIGKILL)."""
        self._process.child.kill()

    async def wait(self) -> int:
        """Return the exit status."""
        return await asyncio.shield(self._status)


async def launch_process(job: Job) -> ProcessWorker:
    """Start ``invid_service.jobs.worker`` and hand it the job."""
    job.folder.mkdir(parents=True, exist_ok=True)
    return await ProcessWorker.start("invid_service.jobs.worker", job, job.folder / "worker.log")


def _launch(module: str, task: object, printed: Path) -> Process:
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    descriptor = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as log_file:
        return launch(module, task, log=log_file, environment=one_thread, own_session=True)
