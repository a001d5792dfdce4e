"""Ask the database: every question of the service as a plain function of plain data.

Synchronous; called from threads. Failures of the database leave as ``SQLAlchemyError``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Engine, and_, delete, func, or_, select, text, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from invid_service.jobs.states import OCCUPYING, UPLOAD, State
from invid_service.store.blobs import Blob
from invid_service.store.tables import (
    ApprovalRow,
    ArtefactRow,
    EventRow,
    IdempotencyRow,
    ModelRow,
    RunRow,
)


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


def _plain(row: Any) -> dict[str, Any]:
    """The columns of a row by name; SQLite forgets the zone of times, and everything is written in UTC."""
    values = {column.name: getattr(row, column.name) for column in row.__table__.columns}
    return {
        name: v.replace(tzinfo=UTC) if isinstance(v, datetime) and v.tzinfo is None else v
        for name, v in values.items()
    }


def _run(row: RunRow) -> RunRecord:
    columns = _plain(row)
    del columns["number"]
    own = {"axes": tuple(row.axes), "state": State(row.state), "facts": dict(row.facts)}
    return RunRecord(**{**columns, **own})


def _columns(run: RunRecord) -> dict[str, Any]:
    """What the table holds of a run."""
    return {**vars(run), "axes": list(run.axes), "state": str(run.state), "facts": dict(run.facts)}


_CHANGE = ("state", "started", "ended", "facts", "robot", "axes", "simulated")
"""Columns of a run that change after it was queued."""


class Store:
    """Questions and changes of the database, each its own transaction."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine

    # --- runs ----------------------------------------------------------------------------------
    def add_run(
        self, run: RunRecord, *, idempotency_key: str | None = None, body_sha256: str = ""
    ) -> RunRecord:
        """Insert a queued run, or return the one this idempotency key already stands for.

        Raises
        ------
        KeyReusedError
            Where the key was used with another body.
        CellBusyError
            Where the cell has a run in progress.
        """
        try:
            with Session(self.engine) as session, session.begin():
                if idempotency_key is not None and run.cell is not None:
                    earlier = session.get(IdempotencyRow, (run.cell, idempotency_key))
                    if earlier is not None:
                        if earlier.body_sha256 != body_sha256:
                            raise KeyReusedError
                        row = session.get_one(RunRow, earlier.run)
                        return _run(row)
                last = select(func.coalesce(func.max(RunRow.number), 0) + 1).scalar_subquery()
                session.add(RunRow(**_columns(run), number=last))
                session.flush()
                if idempotency_key is not None and run.cell is not None:
                    used = {"cell": run.cell, "key": idempotency_key, "body_sha256": body_sha256}
                    session.add(IdempotencyRow(**used, run=run.id, created=run.created))
            return run
        except IntegrityError:
            if idempotency_key is not None and run.cell is not None:
                found = self.find_idempotent(run.cell, idempotency_key, body_sha256)
                if found is not None:
                    return found
            raise CellBusyError from None

    def find_idempotent(self, cell: str, key: str, body_sha256: str) -> RunRecord | None:
        """Return the run this key stands for; KeyReusedError with another body."""
        with Session(self.engine) as session:
            earlier = session.get(IdempotencyRow, (cell, key))
            if earlier is None:
                return None
            if earlier.body_sha256 != body_sha256:
                raise KeyReusedError
            return _run(session.get_one(RunRow, earlier.run))

    def save_state(self, run: RunRecord, event: StoredEvent | None) -> None:
        """Write the run's state and facts with the event that tells of it."""
        with Session(self.engine) as session, session.begin():
            session.execute(
                update(RunRow)
                .where(RunRow.id == run.id)
                .values({name: value for name, value in _columns(run).items() if name in _CHANGE})
            )
            if event is not None and session.get(EventRow, (run.id, event.id)) is None:
                session.add(EventRow(run=run.id, id=event.id, type=event.type, data=dict(event.data)))

    def run(self, run_id: str) -> RunRecord | None:
        """Return one run."""
        with Session(self.engine) as session:
            row = session.get(RunRow, run_id)
            return None if row is None else _run(row)

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
        query = select(RunRow).order_by(RunRow.number.desc(), RunRow.id.desc()).limit(limit)
        if cell is not None:
            query = query.where(RunRow.cell == cell)
        if state is not None:
            query = query.where(RunRow.state == str(state))
        if measured:
            query = query.where(RunRow.mode != UPLOAD)
        if since is not None:
            query = query.where(RunRow.created >= since)
        if until is not None:
            query = query.where(RunRow.created < until)
        with Session(self.engine) as session:
            if after is not None:
                last = session.get(RunRow, after)
                if last is None:
                    raise KeyError(after)
                query = query.where(
                    or_(RunRow.number < last.number, and_(RunRow.number == last.number, RunRow.id < last.id))
                )
            return [_run(row) for row in session.scalars(query)]

    def events(self, run_id: str, after: int = 0) -> list[StoredEvent]:
        """Return the stored events of a run."""
        query = select(EventRow).where(EventRow.run == run_id, EventRow.id > after).order_by(EventRow.id)
        with Session(self.engine) as session:
            return [StoredEvent(row.id, row.type, row.data) for row in session.scalars(query)]

    def interrupt_unfinished(
        self, now: datetime, error_of: Callable[[RunRecord], dict[str, Any]]
    ) -> list[RunRecord]:
        """Mark what a restart cut off, each with its error; called once, before anything else may start."""
        with Session(self.engine) as session, session.begin():
            query = select(RunRow).where(RunRow.state.in_([str(s) for s in OCCUPYING]))
            rows = list(session.scalars(query))
            for row in rows:
                last = session.scalars(
                    select(EventRow.id).where(EventRow.run == row.id).order_by(EventRow.id.desc()).limit(1)
                ).first()
                error = error_of(_run(row))
                row.facts = {**row.facts, "error": error}
                row.state, row.ended = str(State.INTERRUPTED), now
                identity = max((last or 0) + 1, int(now.timestamp() * 1000))
                session.add(
                    EventRow(run=row.id, id=identity, type="state", data={"state": row.state, "error": error})
                )
            return [_run(row) for row in rows]

    # --- artefacts -----------------------------------------------------------------------------
    def add_artefacts(self, run_id: str, blobs: Mapping[str, Blob], now: datetime) -> None:
        """Register stored files."""
        with Session(self.engine) as session, session.begin():
            for kind, blob in blobs.items():
                session.merge(ArtefactRow(run=run_id, kind=kind, created=now, deleted=None, **vars(blob)))

    def artefacts(self, run_id: str) -> dict[str, Blob | None]:
        """Return the files of a run by kind; ``None`` where one was deleted after its retention."""
        with Session(self.engine) as session:
            rows = session.scalars(select(ArtefactRow).where(ArtefactRow.run == run_id))
            return {
                row.kind: None if row.deleted is not None else Blob(row.path, row.size, row.sha256)
                for row in rows
            }

    def expire_artefacts(self, before: datetime, now: datetime) -> list[str]:
        """Mark files of ended runs older than ``before`` as deleted, accepted models' apart; return their
        paths.
        """
        kept = select(ApprovalRow.model)
        with Session(self.engine) as session, session.begin():
            query = (
                select(ArtefactRow)
                .join(RunRow, RunRow.id == ArtefactRow.run)
                .where(RunRow.ended < before, ArtefactRow.deleted.is_(None), RunRow.id.not_in(kept))
            )
            rows = list(session.scalars(query))
            for row in rows:
                row.deleted = now
            session.execute(delete(IdempotencyRow).where(IdempotencyRow.created < before))
            return [row.path for row in rows]

    # --- models --------------------------------------------------------------------------------
    def add_model(self, model: StoredModel) -> None:
        """Keep an identified model."""
        with Session(self.engine) as session, session.begin():
            session.merge(ModelRow(**vars(model)))

    def model(self, cell: str, model_id: str) -> StoredModel | None:
        """Return one model of a cell."""
        with Session(self.engine) as session:
            row = session.get(ModelRow, model_id)
            return None if row is None or row.cell != cell else StoredModel(**_plain(row))

    def models(self, cell: str, limit: int = 200) -> list[StoredModel]:
        """Return the models of a cell, that of the last run first."""
        query = select(ModelRow).join(RunRow, RunRow.id == ModelRow.id).where(ModelRow.cell == cell)
        with Session(self.engine) as session:
            rows = session.scalars(query.order_by(RunRow.number.desc(), RunRow.id.desc()).limit(limit))
            return [StoredModel(**_plain(row)) for row in rows]

    def approve(self, cell: str, model_id: str, *, by: str, how: str, now: datetime) -> Approval:
        """Take a model into force."""
        with Session(self.engine) as session, session.begin():
            row = ApprovalRow(cell=cell, model=model_id, at=now, by=by, how=how)
            session.add(row)
            session.flush()
            return Approval(**_plain(row))

    def approvals(self, cell: str) -> list[Approval]:
        """Return the history of accepted models, newest first."""
        query = select(ApprovalRow).where(ApprovalRow.cell == cell).order_by(ApprovalRow.id.desc())
        with Session(self.engine) as session:
            return [Approval(**_plain(row)) for row in session.scalars(query)]

    def ping(self) -> None:
        """Raise where the database does not answer."""
        with self.engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()
