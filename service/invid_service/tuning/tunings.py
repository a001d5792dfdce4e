"""Tunings of finished runs: one at a time, each in a process of its own, kept beside the run's other
files."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime

from invid_drivers.protocol import Failed
from invid_service.jobs.launcher import ProcessWorker
from invid_service.jobs.protocol import TuningTask
from invid_service.store.blobs import KINDS, Blobs
from invid_service.store.store import Store

log = logging.getLogger(__name__)
TUNING_KINDS = ("tuning", "tuning-page", "tuning-picture", "tuning-files")


class Tunings:
    """What is being tuned, and why the last try of a run failed (until the service starts anew)."""

    def __init__(self, store: Store, blobs: Blobs, clock: Callable[[], datetime], timeout_s: float) -> None:
        self._store, self._blobs, self._clock, self._timeout_s = store, blobs, clock, timeout_s
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._failed: dict[str, str] = {}
        self._one = asyncio.Semaphore(1)

    def is_running(self, run: str) -> bool:
        """Whether a tuning of this run is in progress, or waits for its turn."""
        return run in self._tasks

    def failure(self, run: str) -> str | None:
        """Why the last try failed, in a sentence; ``None`` where it did not."""
        return self._failed.get(run)

    def start(self, run: str, task: TuningTask) -> None:
        """Begin; nothing more where it has begun. The folder of ``task`` is a scratch folder of the run."""
        if run in self._tasks:
            return
        self._failed.pop(run, None)
        work = asyncio.create_task(self._carry_out(run, task))
        self._tasks[run] = work
        work.add_done_callback(lambda _: self._tasks.pop(run, None))

    async def close(self) -> None:
        """End what runs."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _carry_out(self, run: str, task: TuningTask) -> None:
        scratch = f"tuning-{run}"
        try:
            async with self._one:
                folder = await asyncio.to_thread(self._blobs.scratch, scratch)
                why = await self._process(replace(task, folder=folder))
            if why is None:
                await asyncio.to_thread(self._keep, run, scratch)
            else:
                self._failed[run] = why
        except Exception as error:
            log.error("run %s: its tuning failed: %s", run, error)
            self._failed[run] = "the tuning failed; the service's log says why"
        finally:
            await asyncio.to_thread(self._blobs.clear_scratch, scratch)

    def _keep(self, run: str, scratch: str) -> None:
        folder = self._blobs.scratch(scratch)
        kept = {kind: self._blobs.put(run, kind, folder / KINDS[kind][0]) for kind in TUNING_KINDS}
        self._store.add_artefacts(run, {k: b for k, b in kept.items() if b is not None}, self._clock())

    async def _process(self, task: TuningTask) -> str | None:
        """Why it did not come to an end well, ``None`` where it did."""
        worker = await ProcessWorker.start("invid_service.tuning.worker", task, task.folder / "worker.log")
        try:
            async with asyncio.timeout(self._timeout_s):
                async for message in worker.messages():
                    return str(message.error) if isinstance(message, Failed) else None
                return f"the tuning ended with status {await worker.wait()}"
        except TimeoutError:
            return f"the tuning took more than {self._timeout_s:.0f} s"
        finally:
            worker.kill()
            await worker.wait()
