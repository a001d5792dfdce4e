"""Ask the database: every question of the service as a plain function of plain data.

Synchronous; called from threads. Failures of the database leave as ``SQLAlchemyError``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from operator import eq, ge, lt, ne
from typing import Any

from sqlalchemy import Connection, Engine, Select, and_, delete, func, insert, or_, select, text, update
from sqlalchemy.exc import IntegrityError

from invid_service.jobs.states import OCCUPYING, UPLOAD, State
from invid_service.store.blobs import Blob
from invid_service.store.tables import APPROVALS, ARTEFACTS, EVENTS, IDEMPOTENCY, MODELS, RUNS


@dataclass(frozen=True)
class RunRecord:
    """A run as stored."""

    id: str
    cell: str | None
    robot: str
    mode: str
    axes: tuple[str, ...]
    simulated: bool
    state: State
    created: datetime
    requested_by: str
    started: datetime | None = None
    ended: datetime | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class StoredEvent:
    """An event with its id."""

    id: int
    type: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class StoredModel:
    """A model of a cell."""

    id: str
    cell: str
    created: datetime
    mode: str
    document: str


@dataclass(frozen=True)
class Approval:
    """A model taken into force."""

    id: int
    cell: str
    model: str
    at: datetime
    by: str
    how: str


class KeyReusedError(Exception):
    """The idempotency key stands for another body."""


class CellBusyError(Exception):
    """Another run occupies the cell."""


def _run(row: Any) -> RunRecord:
    own = {"axes": tuple(row.axes), "state": State(row.state)}
    return RunRecord(**{name: v for name, v in row._mapping.items() if name not in _ASIDE} | own)


def _columns(run: RunRecord) -> dict[str, Any]:
    """What the table holds of a run."""
    return {**vars(run), "axes": list(run.axes), "state": str(run.state), "facts": dict(run.facts)}


def _add(link: Connection, run: str, event: StoredEvent) -> None:
    link.execute(insert(EVENTS).values(run=run, id=event.id, type=event.type, data=dict(event.data)))


_ASIDE = ("number", "body_sha256")
"""Columns that are nothing of the run itself."""
_CHANGE = ("state", "started", "ended", "facts", "robot", "axes", "simulated")
"""Columns of a run that change after it was queued."""
_LAST_FIRST = (RUNS.c.number.desc(), RUNS.c.id.desc())


class Store:
    """Questions and changes of the database, each its own transaction."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    def _all(self, query: Select[Any]) -> Sequence[Any]:
        with self.engine.connect() as link:
            return link.execute(query).all()

    # --- runs ----------------------------------------------------------------------------------
    def add_run(self, run: RunRecord, *, idempotency_key: str | None = None, body_sha256: str = "") -> None:
        """Insert a queued run; CellBusyError where another service has run its cell, or used its key, since
        it was looked for.
        """
        last = select(func.coalesce(func.max(RUNS.c.number), 0) + 1).scalar_subquery()
        try:
            with self.engine.begin() as link:
                link.execute(insert(RUNS).values(**_columns(run), number=last))
                if run.cell is not None and idempotency_key is not None:
                    used = {"cell": run.cell, "key": idempotency_key, "body_sha256": body_sha256}
                    link.execute(insert(IDEMPOTENCY).values(**used, run=run.id, created=run.created))
        except IntegrityError:
            raise CellBusyError from None

    def find_idempotent(self, cell: str, key: str, body_sha256: str) -> RunRecord | None:
        """Return the run this key stands for; KeyReusedError with another body."""
        query = select(RUNS, IDEMPOTENCY.c.body_sha256).join(IDEMPOTENCY, IDEMPOTENCY.c.run == RUNS.c.id)
        for row in self._all(query.where(IDEMPOTENCY.c.cell == cell, IDEMPOTENCY.c.key == key)):
            if row.body_sha256 != body_sha256:
                raise KeyReusedError
            return _run(row)
        return None

    def save_state(self, run: RunRecord, event: StoredEvent | None) -> None:
        """Write the run's state and facts with the event that tells of it."""
        changed = {name: value for name, value in _columns(run).items() if name in _CHANGE}
        with self.engine.begin() as link:
            link.execute(update(RUNS).where(RUNS.c.id == run.id).values(changed))
            if event is not None:
                known = select(EVENTS.c.id).where(EVENTS.c.run == run.id, EVENTS.c.id == event.id)
                if link.execute(known).first() is None:
                    _add(link, run.id, event)

    def run(self, run_id: str) -> RunRecord | None:
        """Return one run."""
        return next((_run(row) for row in self._all(select(RUNS).where(RUNS.c.id == run_id))), None)

    def runs(  # noqa: PLR0913 - the query's filters
        self,
        *,
        cell: str | None = None,
        state: State | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        after: str | None = None,
        limit: int = 50,
        measured: bool = False,
    ) -> list[RunRecord]:
        """Return runs, the last started first.

        Parameters
        ----------
        since, until
            Bounds of the time of start, the first within, the second not.
        after
            Id of the run behind which the list goes on; KeyError where there is none.
        measured
            Without those of uploaded recordings.
        """
        given = (
            (cell, eq, RUNS.c.cell),
            (None if state is None else str(state), eq, RUNS.c.state),
            (since, ge, RUNS.c.created),
            (until, lt, RUNS.c.created),
            (UPLOAD if measured else None, ne, RUNS.c.mode),
        )
        query = select(RUNS).where(*(is_so(column, v) for v, is_so, column in given if v is not None))
        query = query.order_by(*_LAST_FIRST).limit(limit)
        if after is not None:
            found = self._all(select(RUNS.c.number, RUNS.c.id).where(RUNS.c.id == after))
            if not found:
                raise KeyError(after)
            number, identity = found[0]
            same = and_(RUNS.c.number == number, RUNS.c.id < identity)
            query = query.where(or_(RUNS.c.number < number, same))
        return [_run(row) for row in self._all(query)]

    def events(self, run_id: str, after: int = 0) -> list[StoredEvent]:
        """Return the stored events of a run."""
        columns = select(EVENTS.c.id, EVENTS.c.type, EVENTS.c.data).order_by(EVENTS.c.id)
        query = columns.where(EVENTS.c.run == run_id, EVENTS.c.id > after)
        return [StoredEvent(*row) for row in self._all(query)]

    def interrupt_unfinished(
        self, now: datetime, error_of: Callable[[RunRecord], dict[str, Any]]
    ) -> list[RunRecord]:
        """Mark what a restart cut off, each with its error; called once, before anything else may start."""
        marked = []
        with self.engine.begin() as link:
            query = select(RUNS).where(RUNS.c.state.in_([str(s) for s in OCCUPYING]))
            for run in [_run(row) for row in link.execute(query)]:
                last = link.scalar(select(func.max(EVENTS.c.id)).where(EVENTS.c.run == run.id))
                facts = {**run.facts, "error": error_of(run)}
                marked.append(replace(run, state=State.INTERRUPTED, ended=now, facts=facts))
                ended = {"state": str(State.INTERRUPTED), "ended": now, "facts": facts}
                link.execute(update(RUNS).where(RUNS.c.id == run.id).values(ended))
                told = {"state": str(State.INTERRUPTED), "error": facts["error"]}
                identity = max((last or 0) + 1, int(now.timestamp() * 1000))
                _add(link, run.id, StoredEvent(identity, "state", told))
        return marked

    # --- artefacts -----------------------------------------------------------------------------
    def add_artefacts(self, run_id: str, blobs: Mapping[str, Blob], now: datetime) -> None:
        """Register stored files."""
        with self.engine.begin() as link:
            earlier = (ARTEFACTS.c.run == run_id, ARTEFACTS.c.kind.in_(blobs))
            link.execute(delete(ARTEFACTS).where(*earlier))
            for kind, blob in blobs.items():
                link.execute(insert(ARTEFACTS).values(run=run_id, kind=kind, created=now, **vars(blob)))

    def artefacts(self, run_id: str) -> dict[str, Blob | None]:
        """Return the files of a run by kind; ``None`` where one was deleted after its retention."""
        rows = self._all(select(ARTEFACTS).where(ARTEFACTS.c.run == run_id))
        return {r.kind: None if r.deleted is not None else Blob(r.path, r.size, r.sha256) for r in rows}

    def expire_artefacts(self, before: datetime, now: datetime) -> list[str]:
        """Mark files of ended runs older than ``before`` as deleted, accepted models' apart; return their
        paths.
        """
        old = select(RUNS.c.id).where(RUNS.c.ended < before, RUNS.c.id.not_in(select(APPROVALS.c.model)))
        expired = (ARTEFACTS.c.run.in_(old), ARTEFACTS.c.deleted.is_(None))
        with self.engine.begin() as link:
            paths = list(link.scalars(select(ARTEFACTS.c.path).where(*expired)))
            link.execute(update(ARTEFACTS).where(*expired).values(deleted=now))
            link.execute(delete(IDEMPOTENCY).where(IDEMPOTENCY.c.created < before))
        return paths

    # --- models --------------------------------------------------------------------------------
    def add_model(self, model: StoredModel) -> None:
        """Keep an identified model."""
        with self.engine.begin() as link:
            known = update(MODELS).where(MODELS.c.id == model.id)
            if not link.execute(known.values(**vars(model))).rowcount:
                link.execute(insert(MODELS).values(**vars(model)))

    def model(self, cell: str, model_id: str) -> StoredModel | None:
        """Return one model of a cell."""
        query = select(MODELS).where(MODELS.c.id == model_id, MODELS.c.cell == cell)
        return next((StoredModel(**row._mapping) for row in self._all(query)), None)

    def models(self, cell: str, limit: int = 200) -> list[StoredModel]:
        """Return the models of a cell, that of the last run first."""
        query = select(MODELS).join(RUNS, RUNS.c.id == MODELS.c.id).where(MODELS.c.cell == cell)
        return [StoredModel(**r._mapping) for r in self._all(query.order_by(*_LAST_FIRST).limit(limit))]

    def approve(self, cell: str, model_id: str, *, by: str, how: str, now: datetime) -> Approval:
        """Take a model into force."""
        row = insert(APPROVALS).values(cell=cell, model=model_id, at=now, by=by, how=how)
        with self.engine.begin() as link:
            return Approval(
                link.execute(row.returning(APPROVALS.c.id)).scalar_one(), cell, model_id, now, by, how
            )

    def approvals(self, cell: str) -> list[Approval]:
        """Return the history of accepted models, newest first."""
        query = select(APPROVALS).where(APPROVALS.c.cell == cell).order_by(APPROVALS.c.id.desc())
        return [Approval(**row._mapping) for row in self._all(query)]

    def ping(self) -> None:
        """Raise where the database does not answer."""
        self._all(select(text("1")))

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()
