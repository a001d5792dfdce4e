"""Build the parts of one application from its settings, and close them together."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from invid.config import CellConfig
from invid.errors import ConfigError, InvidError, ModelError
from invid.planning.belief import from_model
from invid.wording.sentence import sentence
from invid_drivers.cia402.standing.holding import Reason as CellReason
from invid_drivers.connect import is_virtual
from invid_drivers.readiness import Asked, ask, foresee, not_ready
from invid_drivers.relay import STOP_S
from invid_drivers.stopping_budgets import Wish
from invid_service.audit import AuditLog
from invid_service.auth import check_bind
from invid_service.cells.readiness import (
    Answer,
    Checked,
    Readiness,
    RecentAnswers,
    Situation,
    readiness,
)
from invid_service.cells.registry import Cell, load_cells
from invid_service.jobs.folder import LastWords, interruption, settle
from invid_service.jobs.launcher import Launcher
from invid_service.jobs.live import LiveRun
from invid_service.jobs.manager import JobManager
from invid_service.jobs.results import Results, load
from invid_service.jobs.states import State
from invid_service.keys import Keys
from invid_service.links import address, set_root
from invid_service.logs import tell_ended
from invid_service.metrics import Metrics
from invid_service.problems import Problem
from invid_service.settings import Settings
from invid_service.store.blobs import Blobs
from invid_service.store.database import open_engine, upgrade
from invid_service.store.lock import DataLock
from invid_service.store.store import RunRecord, Store, StoredModel
from invid_service.tuning.tunings import Tunings
from invid_service.words import REASONS

log = logging.getLogger(__name__)
T = TypeVar("T")
Clock = Callable[[], datetime]
_DRIVES_REFUSED = ("drive", "bus")
"""Codes of runs that ended because a drive or the bus did not do its part."""
_RETENTION_PERIOD_S = 3600.0
_STORE_PROBE_S = 1.0
_KEY_PERIOD_S = 1.0
"""A key added, or revoked, counts within this time."""
_ORPHAN_S = 3.0
"""Beyond the grace of a runner: what it takes to close its recording."""


@dataclass
class Service:
    """Everything a request may need, in one object."""

    settings: Settings
    clock: Clock
    lock: DataLock
    keys: Keys
    audit: AuditLog
    store: Store
    blobs: Blobs
    results: Results
    jobs: JobManager
    cells: dict[str, Cell]
    metrics: Metrics
    tunings: Tunings
    start_locks: dict[str, asyncio.Lock] = field(default_factory=lambda: defaultdict(asyncio.Lock))
    can_start: RecentAnswers = field(default_factory=RecentAnswers)
    shutting_down: bool = False
    _planning: asyncio.Lock = field(default_factory=asyncio.Lock)
    _answers: dict[str, Answer] = field(default_factory=dict)
    _refusals: dict[tuple[object, ...], InvidError | None] = field(default_factory=dict)
    _housekeeping: asyncio.Task[None] | None = None
    _key_watch: asyncio.Task[None] | None = None

    # --- life ----------------------------------------------------------------------------------
    async def start(self) -> None:
        """Settle what the last process left, then start the housekeeping."""
        set_root(self.settings.root_path)  # for what tells of a run outside any request
        await asyncio.to_thread(settle, self.blobs.work, self.settings.stop_grace_s + _ORPHAN_S)
        now = self.clock()
        cut = await asyncio.to_thread(
            self.store.interrupt_unfinished,
            now,
            lambda run: interruption(run, LastWords.read(self.blobs.work / run.id)),
        )
        for record in cut:
            tell_ended(record)
        await asyncio.to_thread(self._keep_leftovers, now)
        for cell in self.cells:
            for record in await asyncio.to_thread(self.store.runs, cell=cell, limit=1, measured=True):
                self.jobs.remember(record)
        for record in await asyncio.to_thread(self.store.runs, state=State.AWAITING_ACCEPT, limit=500):
            self.jobs.restore(record, await asyncio.to_thread(self.store.events, record.id))
        self._housekeeping = asyncio.create_task(self._keep_house())
        self._key_watch = asyncio.create_task(self._watch_keys())

    def _keep_leftovers(self, now: datetime) -> None:
        """Store all that runs before this start left in their folders.

        Nothing runs yet, so whatever lies there is of a run that was cut off, or that the store did not take.
        """
        for folder in sorted(self.blobs.work.iterdir()):
            try:
                record = self.store.run(folder.name)
                if record is not None:  # else an upload that was never taken
                    self.results.keep(record, now)
                self.results.clear(folder.name)
            except (OSError, SQLAlchemyError) as error:
                log.error("what run %s left stays in %s: %s", folder.name, folder, error)

    def begin_shutdown(self) -> None:
        """Stop motion and end the streams; called as soon as the signal is there."""
        self.shutting_down = True
        self.jobs.begin_shutdown()

    async def close(self) -> None:
        """Stop motion first, then close the rest."""
        self.begin_shutdown()
        for task in (self._housekeeping, self._key_watch):
            if task is not None:
                task.cancel()
        await self.jobs.shutdown()
        await self.tunings.close()
        self.store.close()
        self.lock.release()

    async def _keep_house(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self.expire)
            except (OSError, SQLAlchemyError) as error:
                log.error("retention: %s", error)
            await asyncio.sleep(_RETENTION_PERIOD_S)

    async def _watch_keys(self) -> None:
        while self.keys.configured:
            await asyncio.sleep(_KEY_PERIOD_S)
            await asyncio.to_thread(self.keys.reload)

    def expire(self) -> int:
        """Delete files past their retention; return how many."""
        now = self.clock()
        paths = self.store.expire_artefacts(now - timedelta(days=self.settings.retention_days), now)
        for relative in paths:
            with contextlib.suppress(OSError, ValueError):
                self.blobs.path(relative).unlink(missing_ok=True)
        return len(paths)

    # --- questions -----------------------------------------------------------------------------
    def cell(self, identity: str) -> Cell:
        """Return a cell; Problem 404 where there is none."""
        found = self.cells.get(identity)
        if found is None:
            raise Problem("cell-not-found", f"no cell {identity[:64]!r}; the cells are {sorted(self.cells)}")
        return found

    async def readiness(
        self,
        cell: Cell,
        mode: str | None = None,
        *,
        ignore: LiveRun | None = None,
        axes: tuple[str, ...] | None = None,
        asked: Asked | None = None,
    ) -> Readiness:
        """Judge now whether the cell can start, by what is remembered of its drives, or as they were asked.

        Nothing is sent to them.
        """
        occupied = self.jobs.occupying(cell.id)
        if asked is not None:
            self._answers[cell.id] = _answer_of(asked, self.clock())
        drives: tuple[CellReason, ...] = ()
        if asked is not None:
            drives = asked.reasons
        elif mode != "simulate" and occupied is None:
            drives = await asyncio.to_thread(not_ready, cell.config)
        answers, in_force = await self.ask_store(self.results.in_force, cell.id)
        return readiness(
            Situation(
                config=cell.config,
                occupied_by=None if occupied is ignore else occupied,
                free_bytes=self.blobs.free_bytes(),
                needed_bytes=self.settings.min_free_bytes,
                store_answers=answers,
                shutting_down=self.shutting_down,
                has_model=in_force is not None,
                mode=mode,  # type: ignore[arg-type]
                axes=axes,
                drives=drives,
                refusal=await self._refusal(cell, mode, axes, in_force),
                answer=self._answer(cell),
            )
        )

    async def ask_store(self, question: Callable[..., T], *about: str) -> tuple[bool, T | None]:
        """Return whether the store answers in time, and what."""
        try:
            async with asyncio.timeout(_STORE_PROBE_S):
                return True, await asyncio.to_thread(question, *about)
        except (TimeoutError, SQLAlchemyError):
            return False, None

    def _answer(self, cell: Cell) -> Answer | None:
        """Return what the drives of a cell said last: to somebody who asked, or to the last run."""
        known, run = self._answers.get(cell.id), self.jobs.latest(cell.id)
        if run is None or run.record.mode == "simulate":
            return known
        record = run.record
        if known is not None and known.at >= (record.ended or record.created):
            return known
        error = record.facts.get("error") or {}
        if record.state is State.FAILED and error.get("code") in _DRIVES_REFUSED:
            return Answer(record.ended or record.created, error["text"], error["fix"])
        return known if record.started is None else Answer(record.started)

    def require_free_bus(self, cell: Cell, why: str = "", **members: Any) -> None:
        """Problem 409 where a run has the bus of a cell; whoever calls it holds the cell's start lock."""
        busy = self.jobs.occupying(cell.id)
        if busy is None:
            return
        run, state = busy.record.id, str(busy.record.state)
        members |= {"simulated": cell.simulated, "identification": run, "state": state}
        members["location"] = address("identifications", run)
        why = why or f"identification {run} is {state}: it has the bus"
        raise Problem("run-in-progress", why, {"Retry-After": "5"}, **members)

    async def check(self, cell: Cell) -> Checked:
        """Ask the drives of a cell in which nothing runs; Problem 409 where something does.

        What an earlier run left in them is restored: this writes to drives.
        """
        async with self.start_locks[cell.id]:
            self.require_free_bus(cell)
            ready, asked = await self.ask_drives(cell)
        return Checked(**dict(ready), warnings=list(dict.fromkeys(asked.said)))

    async def ask_drives(
        self, cell: Cell, mode: str | None = None, axes: tuple[str, ...] | None = None
    ) -> tuple[Readiness, Asked]:
        """Ask the drives and judge by what they say; whoever calls it holds the cell's start lock."""
        asked = await asyncio.to_thread(ask, cell.config)
        return await self.readiness(cell, mode, axes=axes, asked=asked), asked

    async def _refusal(
        self, cell: Cell, mode: str | None, axes: tuple[str, ...] | None, in_force: StoredModel | None
    ) -> InvidError | None:
        """Return with what check and run would refuse to plan; judged once for each model and wish.

        Hardware is not asked for it: whoever reads a page sends nothing to drives. A real cell that is
        simulated with its model plans within other drives.
        """
        if mode == "simulate" and not cell.simulated:
            return None
        amplitude = cell.config.safety.test_amplitude if mode == "test" else 1.0
        key = (cell.id, amplitude, axes, None if in_force is None else in_force.id)
        async with self._planning:
            if key not in self._refusals:
                self._refusals[key] = await asyncio.to_thread(
                    _refusal_of, cell.config, amplitude, axes, in_force
                )
            return self._refusals[key]

    async def run(self, run_id: str) -> tuple[RunRecord, LiveRun | None]:
        """Return a run, from memory while it lives; Problem 404 where there is none."""
        live = self.jobs.live(run_id)
        if live is not None:
            return live.record, live
        record = None
        if len(run_id) <= 40 and run_id.isascii() and run_id.replace("-", "").isalnum():
            record = await asyncio.to_thread(self.store.run, run_id)
        if record is None:
            raise Problem("identification-not-found", f"no identification {run_id[:64]!r}")
        return record, self.jobs.live(run_id)

    def new_run(self, cell: Cell | None, mode: str, axes: list[str], caller: str) -> RunRecord:
        """Return a queued run with a fresh id that sorts by time."""
        now = self.clock()
        identity = f"{now:%Y%m%dT%H%M%S}-{secrets.token_hex(4)}"
        simulated = cell is not None and (cell.simulated or mode == "simulate")
        return RunRecord(
            id=identity,
            cell=None if cell is None else cell.id,
            robot="" if cell is None else cell.config.robot,
            mode=mode,
            axes=tuple(axes),
            simulated=simulated,
            state=State.QUEUED,
            created=now,
            requested_by=caller,
        )


def _refusal_of(
    config: CellConfig, amplitude: float, axes: tuple[str, ...] | None, in_force: StoredModel | None
) -> InvidError | None:
    belief = None
    if in_force is not None:
        with contextlib.suppress(ModelError):  # of other axes, or damaged: the run does without it too
            belief = from_model(load(in_force), config, source=sentence("the accepted model"))
    try:
        foresee(config, Wish(axes, amplitude, belief))
    except InvidError as error:
        return error
    return None


def _answer_of(asked: Asked, now: datetime) -> Answer:
    error = asked.refusal
    if error is None:
        return Answer(now)
    return Answer(now, error.reason or str(error), error.way_out or sentence(REASONS["check_refused"][1]))


def utc_now() -> datetime:
    """Return the time by the clock of the service."""
    return datetime.now(UTC)


def build(settings: Settings, launcher: Launcher, clock: Clock) -> Service:
    """Build the service from settings; ConfigError where something cannot be."""
    keys = Keys(settings.key_file)
    check_bind(settings, keys)
    lock = DataLock(settings.data_dir)
    try:
        cells = load_cells(settings.cells, settings.data_dir)
        engine = open_engine(settings.database)
        upgrade(engine)
        store, blobs = Store(engine), Blobs(settings.data_dir / "files")
        results = Results(store, blobs, settings)
        if settings.stop_grace_s < STOP_S and not all(is_virtual(c.config) for c in cells.values()):
            raise ConfigError(
                f"stop_grace_s is {settings.stop_grace_s:g}: a runner that stops its drives in order may "
                f"take {STOP_S:.0f} s; leave it out, or set more"
            )
        jobs = JobManager(store, results, launcher, settings, clock)
        metrics = Metrics(lambda: len([c for c in cells if jobs.occupying(c) is not None]))

        def ended(run: LiveRun) -> None:
            metrics.ended(str(run.record.state), run.record.mode)

        jobs.on_end = ended
        tunings = Tunings(store, blobs, clock, settings.analysis_timeout_s)
        audit = AuditLog(settings.data_dir / "audit.jsonl")
    except BaseException:
        lock.release()
        raise
    return Service(
        settings=settings,
        clock=clock,
        lock=lock,
        keys=keys,
        audit=audit,
        store=store,
        blobs=blobs,
        results=results,
        jobs=jobs,
        cells=cells,
        metrics=metrics,
        tunings=tunings,
    )


__all__ = ["Clock", "Service", "build", "utc_now"]
