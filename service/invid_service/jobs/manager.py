"""Take jobs, watch their runner processes, keep their state machine.

Lives on the event loop. What it knows of runs in progress it knows in memory; the store is told, in a
thread, and a store that hangs or fails never keeps a stop from reaching the drives.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from invid import disk
from invid.config import CellConfig
from invid.wording.sentence import joined, sentence
from invid_drivers.protocol import AxisStates, Done, Stop
from invid_drivers.readiness import known_after_death
from invid_service.jobs.folder import unseen
from invid_service.jobs.launcher import Launcher
from invid_service.jobs.live import LiveRun, Wish, WrongStateError
from invid_service.jobs.protocol import (
    Arm,
    End,
    EndedEarly,
    Job,
    Measured,
    Planned,
    Read,
    Running,
    RunProgress,
    Told,
)
from invid_service.jobs.results import Results
from invid_service.jobs.states import OCCUPYING, UPLOAD, State
from invid_service.jobs.stops import without_trace
from invid_service.logs import tell_began, tell_ended
from invid_service.settings import Settings
from invid_service.store.database import is_full
from invid_service.store.store import RunRecord, Store, StoredEvent
from invid_service.words import UNSEEN, error_of

log = logging.getLogger(__name__)
_RETRY_S = 1.0
_KEEP_RETRY_S = 5.0
_LAST_WORDS_S = 2.0
"""At the end: for the store to take the last state of a run; one that does not answer is not waited for."""


@dataclass(frozen=True)
class Decision:
    """What became of a result: ``by`` is who says so, ``caller`` the key that was used.

    ``override``: why a result that is not to be trusted was accepted all the same.
    """

    accept: bool
    by: str
    caller: str
    override: str | None = None

    def facts(self, now: datetime) -> dict[str, Any]:
        """Plain values; the caller where it is not who decided."""
        told = {"type": "accepted" if self.accept else "rejected", "by": self.by, "at": now.isoformat()}
        if self.caller != self.by:
            told["caller"] = self.caller
        if self.accept and self.override is not None:
            told["override"] = self.override
        return told


def _results_of(job: Job) -> set[str]:
    """The kinds of files without which a job has not come to its end."""
    if job.mode == "verify":
        return {"recording", "verification"}
    return {"recording", "model", "diagnosis", "report"}


Moved = tuple[State, dict[str, Any]]
"""A state, and the facts that belong to it."""


def _failure(error: dict[str, Any]) -> Moved:
    return State.FAILED, {"error": error}


def _early_end(run: LiveRun) -> Moved:
    ends = {"stop": State.STOPPED, "cancel": State.CANCELLED, "shutdown": State.INTERRUPTED}
    state = ends[run.wish or "cancel"]
    return state, {"error": run.record.facts.get("error") or error_of(state, state=str(run.record.state))}


def _not_stored(error: Exception, job: Job) -> dict[str, Any]:
    if is_full(error) or (isinstance(error, OSError) and disk.is_full(error)):
        return error_of("disk-full", free=disk.free(job.folder))
    return error_of("store-unavailable")


class JobManager:
    """Runs in progress, one per cell."""

    def __init__(
        self,
        store: Store,
        results: Results,
        launcher: Launcher,
        settings: Settings,
        clock: Callable[[], datetime],
    ) -> None:
        self._store, self._results, self._launch = store, results, launcher
        self._settings, self._clock = settings, clock
        self._live: dict[str, LiveRun] = {}
        self._latest: dict[str, LiveRun] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._uploads = asyncio.Semaphore(settings.parallel_uploads)
        self.on_end: Callable[[LiveRun], None] = lambda run: None

    # --- what is going on ----------------------------------------------------------------------
    def live(self, run_id: str) -> LiveRun | None:
        """Return a run in memory; ``None`` where it has left."""
        return self._live.get(run_id)

    def occupying(self, cell: str) -> LiveRun | None:
        """Return the run that occupies a cell."""
        for run in self._live.values():
            if run.record.cell == cell and run.occupies:
                return run
        return None

    def latest(self, cell: str) -> LiveRun | None:
        """Return the last started measurement of a cell, in progress or ended; the store is not asked."""
        return self._latest.get(cell)

    def is_lost(self, cell: str) -> bool:
        """Whether the last measurement of a cell ended and nobody saw its axes at rest."""
        run = self._latest.get(cell)
        return run is not None and (run.record.facts.get("error") or {}).get("axes") is not None

    def remember(self, record: RunRecord) -> None:
        """Take up what was the last measurement of its cell before a restart, or until it ended."""
        if record.cell is not None and record.mode != UPLOAD:
            self._latest[record.cell] = LiveRun(record)

    def restore(self, record: RunRecord, stored: list[StoredEvent]) -> None:
        """Take up a result that awaits accept since before a restart."""
        run = LiveRun(record, stored)
        self._live[record.id] = run
        latest = self._latest.get(record.cell or "")
        if latest is not None and latest.record.id == record.id:
            self._latest[record.cell or ""] = run

    # --- taking jobs ---------------------------------------------------------------------------
    async def begin(self, record: RunRecord, job: Job, *, key: str | None = None, digest: str = "") -> None:
        """Take a run and run its job in the background; nothing is left where the store does not take it.

        CellBusyError where another service runs the cell on the same database.
        """
        run = LiveRun(record)
        self._live[record.id] = run  # the cell is occupied before the store is asked
        try:
            await asyncio.to_thread(self._store.add_run, record, idempotency_key=key, body_sha256=digest)
        except BaseException:
            del self._live[record.id]
            raise
        if record.cell is not None and record.mode != UPLOAD:
            self._latest[record.cell] = run
        tell_began(record)
        self._spawn(self._run(run, job))

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # --- wishes --------------------------------------------------------------------------------
    def stop_cell(self, cell: str) -> LiveRun | None:
        """Stop whatever the cell does. Touches memory and one pipe; returns at once."""
        run = self.occupying(cell)
        if run is not None:
            self._end_early(run, "stop")
        return run

    async def cancel(self, run: LiveRun) -> None:
        """End a run without a result; waits until its motion has ended or the grace is over."""
        if run.record.state is State.AWAITING_ACCEPT:
            await self.decide(run, Decision(accept=False, by="cancel", caller="cancel"))
        elif run.record.state in OCCUPYING:
            self._end_early(run, "cancel")
            deadline = self._settings.stop_grace_s + 2.0
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(deadline):
                    while not run.ended:
                        await run.events.news.wait()

    async def arm(self, run: LiveRun) -> None:
        """Let the run move; WrongStateError where it does not wait for that. Twice is no error."""
        async with run.lock:
            if run.record.state is State.RUNNING:
                return
            if run.record.state is not State.AWAITING_ARM or run.worker is None or run.wish:
                raise WrongStateError(str(run.record.state))
            await self._persist(run, run.set(State.RUNNING, self._clock()))
        run.worker.send(Arm())

    async def decide(self, run: LiveRun, decision: Decision) -> None:
        """Accept or reject the result; WrongStateError where there is none to decide on."""
        async with run.lock:
            if run.record.state is not State.AWAITING_ACCEPT:
                raise WrongStateError(str(run.record.state))
            now = self._clock()
            if decision.accept and run.record.cell is not None:
                await asyncio.to_thread(
                    self._store.approve, run.record.cell, run.record.id, by=decision.by, how="accept", now=now
                )
            state = State.SUCCEEDED if decision.accept else State.CANCELLED
            event = run.set(state, now, {"decision": decision.facts(now)})
            await self._persist(run, event)
        self._retire(run)

    def _retire(self, run: LiveRun) -> None:
        """Forget an ended run, once the store has it."""
        if run.ended and not run.unsaved and self._live.pop(run.record.id, None) is not None:
            if self._latest.get(run.record.cell or "") is run:
                self.remember(run.record)  # without its events
            self.on_end(run)

    def _end_early(self, run: LiveRun, wish: Wish) -> None:
        if run.wish is None or wish == "stop":
            run.wish = wish
        worker = run.worker
        if worker is None:
            return  # not launched yet: the launch looks at the wish
        if run.record.state in (State.ANALYSING, State.AWAITING_ARM):
            worker.kill()  # nothing moves
        else:
            self._spawn(self._stop_worker(run))

    async def _stop_worker(self, run: LiveRun) -> None:
        worker = run.worker
        if worker is None:
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._settings.stop_grace_s):
                worker.send(Stop())
                await run.motion_ended.wait()
                return
        log.error("run %s: the runner did not stop in time and is killed", run.record.id)
        run.killed = True
        worker.kill()

    # --- the life of a run ---------------------------------------------------------------------
    async def _run(self, run: LiveRun, job: Job) -> None:
        guard = self._uploads if job.kind == "analyse" else contextlib.nullcontext()
        kept = False
        try:
            async with guard:
                kept = await self._watch(run, job)
        except asyncio.CancelledError:
            raise
        except Exception as error:
            log.exception("run %s", run.record.id)
            full = isinstance(error, OSError) and disk.is_full(error)
            if not run.ended:
                await self._move(
                    run, *_failure(_not_stored(error, job) if full else error_of("internal-error"))
                )
        finally:
            run.motion_ended.set()
            if kept:
                await asyncio.to_thread(self._results.clear, run.record.id)
            else:
                self._spawn(self._keep_later(run))
            self._retire(run)

    async def _keep_later(self, run: LiveRun) -> None:
        """Store what a run left as soon as disk and store take it; what they do not take before the service
        ends waits for its next start.
        """
        while True:
            await asyncio.sleep(_KEEP_RETRY_S)
            with contextlib.suppress(OSError, SQLAlchemyError):
                await asyncio.to_thread(self._results.keep, run.record, self._clock())
                await asyncio.to_thread(self._results.clear, run.record.id)
                log.info("run %s: what it left is stored now", run.record.id)
                return

    async def _watch(self, run: LiveRun, job: Job) -> bool:
        """Follow a run to its end; return whether all that it left is in the store."""
        if run.wish is not None:
            await self._move(run, *_early_end(run))
            return True
        await self._move(run, State.ANALYSING if job.kind == "analyse" else State.CHECKING)
        worker = await self._launch(job)
        run.worker = worker
        watchdog = asyncio.create_task(self._watchdog(run))
        verdict: End | None = None
        try:
            if run.wish is not None:
                worker.kill()
            async for message in worker.messages():
                if isinstance(message, Done | EndedEarly):
                    verdict = message
                    run.motion_ended.set()
                    break
                await self._hear(run, message)
            status = await self._reap(run)
        finally:
            watchdog.cancel()
            worker.kill()
        kept = await self._keep_results(run)
        await self._conclude(run, job, verdict, status, kept)
        return isinstance(kept, set)

    async def _reap(self, run: LiveRun) -> int:
        worker = run.worker
        if worker is None:
            return -1
        try:
            return await asyncio.wait_for(worker.wait(), 10.0)
        except TimeoutError:
            worker.kill()
            return await worker.wait()

    async def _hear(self, run: LiveRun, message: Told) -> None:
        match message:
            case Planned(plan=plan, arm=arm):
                run.note(plan=plan)
                run.events.append("plan", plan)
                if not arm and run.wish is None:
                    await self._move(run, State.AWAITING_ARM)
            case Running():
                if run.record.state is State.CHECKING:
                    await self._move(run, State.RUNNING)
            case RunProgress():
                run.advance(message)
            case AxisStates():
                run.axes = message
            case Measured(measurement=measurement):
                run.motion_ended.set()
                if run.wish is None:
                    await self._move(run, State.ANALYSING, {"measurement": measurement})
            case Read(robot=robot, axes=axes, simulated=simulated):
                run.record = replace(run.record, robot=robot, axes=axes, simulated=simulated)

    async def _watchdog(self, run: LiveRun) -> None:
        """End a run that hangs: each state has its time, a motion from one thing that it says to the next."""
        while not run.ended:
            state = run.record.state
            moves = state is State.RUNNING
            bound = {
                State.CHECKING: self._settings.check_timeout_s,
                State.AWAITING_ARM: self._settings.arm_timeout_s,
                State.RUNNING: self._settings.motion_silence_s,
                State.ANALYSING: self._settings.analysis_timeout_s,
            }.get(state)
            said = run.progress.place
            try:
                async with asyncio.timeout(bound):
                    while run.record.state is state and not (moves and run.progress.place != said):
                        await run.events.news.wait()
            except TimeoutError:
                if run.wish is None:
                    run.note(error=error_of("timeout", state=str(state), seconds=f"{bound:.0f}"))
                    run.wish = "cancel"
                if moves:
                    await self._stop_worker(run)
                elif run.worker is not None:
                    run.worker.kill()
                return

    async def _keep_results(self, run: LiveRun) -> set[str] | Exception:
        """Store the files of a run; return their kinds, or why the store did not take them."""
        try:
            return await asyncio.to_thread(self._results.keep, run.record, self._clock())
        except (OSError, SQLAlchemyError) as error:
            log.error("run %s: results could not be stored: %s", run.record.id, error)
            return error

    async def _conclude(
        self, run: LiveRun, job: Job, verdict: End | None, status: int, kept: set[str] | Exception
    ) -> None:
        """Move a run whose runner has ended to where it ends, or to where a person decides."""
        if isinstance(verdict, EndedEarly) and verdict.stopped is not None:
            run.note(stopped=verdict.stopped)
        if verdict is None and run.record.state is State.RUNNING:
            end = await self._lost(run, job, status)
        elif run.wish is not None:
            end = _early_end(run)
        elif verdict is None:
            end = _failure(error_of("runner-died", status=str(status)))
        elif isinstance(verdict, EndedEarly):
            state = State.STOPPED if verdict.type == "stopped" else State.FAILED
            end = state, {"error": verdict.error.model_dump(exclude_none=True)}
        elif isinstance(kept, Exception):  # they wait in its folder for a store that takes them
            end = _failure(_not_stored(kept, job))
        elif not _results_of(job) <= kept:
            log.error("run %s: the runner ended without all of its results", run.record.id)
            end = _failure(error_of("internal-error"))
        else:
            end = await self._success(run, job, verdict.result)
        await self._move(run, *end)

    async def _success(self, run: LiveRun, job: Job, summary: dict[str, Any]) -> Moved:
        if run.record.cell is None or not job.acceptable or job.mode == "verify":
            return State.SUCCEEDED, {"summary": summary}
        summary = await asyncio.to_thread(self._results.concluded, run.record, summary, self._clock())
        # A short check says what changed, and is no model to run a robot with.
        return State.SUCCEEDED if job.mode == "screen" else State.AWAITING_ACCEPT, {"summary": summary}

    async def _lost(self, run: LiveRun, job: Job, status: int) -> Moved:
        """How a run ends whose runner was killed, or died, in motion: nobody has seen its axes at rest."""
        known: tuple[str, ...] = ()
        if job.config is not None:
            config = CellConfig.model_validate(job.config)
            known = await asyncio.to_thread(known_after_death, config, self._settings.stop_grace_s)
        grace = f"{self._settings.stop_grace_s:.0f}"
        died, deaf = error_of("runner-died", status=str(status)), error_of("not-stopped", seconds=grace)
        reason = joined([sentence("the process that moved it was lost"), sentence(UNSEEN)], ". ")
        return State.FAILED, {
            "stopped": without_trace(run.progress.phase, run.progress.axis, reason),
            "error": unseen(deaf if run.killed else died, run.axes, run.record.axes, known),
        }

    async def _move(self, run: LiveRun, state: State, facts: dict[str, Any] | None = None) -> None:
        async with run.lock:
            event = run.set(state, self._clock(), facts)
            await self._persist(run, event)

    async def _persist(self, run: LiveRun, event: StoredEvent) -> None:
        """Store the state of a run; a store that does not answer is asked again later, motion does not
        wait.
        """
        if run.ended or run.record.state is State.AWAITING_ACCEPT:
            tell_ended(run.record)
        try:
            await asyncio.to_thread(self._store.save_state, run.record, event)
        except SQLAlchemyError as error:
            log.error("run %s: state %s not stored yet: %s", run.record.id, run.record.state, error)
            run.unsaved = True
            self._spawn(self._persist_later(run, event))

    async def _persist_later(self, run: LiveRun, event: StoredEvent) -> None:
        while True:
            await asyncio.sleep(_RETRY_S)
            with contextlib.suppress(SQLAlchemyError):
                await asyncio.to_thread(self._store.save_state, run.record, event)
                run.unsaved = False
                self._retire(run)
                return

    # --- the end -------------------------------------------------------------------------------
    def begin_shutdown(self) -> None:
        """Stop every motion, and let the followers of runs that wait for a decision go."""
        for run in self._live.values():
            if run.record.state in OCCUPYING:
                if run.wish is None:
                    self._end_early(run, "shutdown")
            else:
                run.events.close()

    async def shutdown(self) -> None:
        """Stop motion first, then everything else."""
        runs = [run for run in self._live.values() if run.record.state in OCCUPYING]
        self.begin_shutdown()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._settings.stop_grace_s + 3.0):
                for run in runs:
                    while not run.ended:
                        await run.events.news.wait()
        # The state is in memory before it is in the store: let what is being written be written.
        if self._tasks:
            await asyncio.wait(list(self._tasks), timeout=_LAST_WORDS_S)
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for run in runs:
            if run.worker is not None:
                run.worker.kill()
        for run in self._live.values():
            run.events.close()
