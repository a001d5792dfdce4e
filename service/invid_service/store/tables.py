"""Tables. Their history is in ``migrations/``; a test compares the two."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, DateTime, ForeignKey, Index, Integer, String, Text, text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class Base(DeclarativeBase):
    """Metadata of the store."""


_ACTIVE = (
    "state IN ('queued', 'checking', 'awaiting_arm', 'running', 'analysing') AND cell IS NOT NULL "
    "AND mode <> 'upload'"
)


class RunRow(Base):
    """One identification."""

    __tablename__ = "runs"
    __table_args__ = (
        # One measurement per cell even where two services should ever share a database.
        Index(
            "one_run_per_cell",
            "cell",
            unique=True,
            sqlite_where=text(_ACTIVE),
            postgresql_where=text(_ACTIVE),
        ),
    )
    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    cell: Mapped[str | None] = mapped_column(String(64), index=True)
    robot: Mapped[str] = mapped_column(Text)
    mode: Mapped[str] = mapped_column(String(16))
    axes: Mapped[list[str]] = mapped_column(JSON)
    simulated: Mapped[bool]
    state: Mapped[str] = mapped_column(String(20), index=True)
    created: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    number: Mapped[int] = mapped_column(Integer, index=True, server_default="0")
    """Grows with every start: the order of the history, whatever the clock says."""
    started: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    ended: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    requested_by: Mapped[str] = mapped_column(Text)
    facts: Mapped[dict[str, Any]] = mapped_column(JSON)
    """plan, error, decision, summary, progress at the end."""


class EventRow(Base):
    """Events that a later reader must still see: changes of state."""

    __tablename__ = "events"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    id: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    type: Mapped[str] = mapped_column(String(20))
    data: Mapped[dict[str, Any]] = mapped_column(JSON)


class ArtefactRow(Base):
    """A file of a run; ``path`` is relative to the folder of files."""

    __tablename__ = "artefacts"
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"), primary_key=True)
    kind: Mapped[str] = mapped_column(String(20), primary_key=True)
    path: Mapped[str] = mapped_column(Text)
    size: Mapped[int] = mapped_column(BigInteger)
    sha256: Mapped[str] = mapped_column(String(64))
    created: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    deleted: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))


class ModelRow(Base):
    """A model identified on a cell, accepted or not."""

    __tablename__ = "models"
    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    """The same as its run's."""
    cell: Mapped[str] = mapped_column(String(64), index=True)
    created: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    mode: Mapped[str] = mapped_column(String(16))
    document: Mapped[str] = mapped_column(Text)
    """The model's JSON as it was written."""


class ApprovalRow(Base):
    """The history of accepted models; only ever added to, the newest is in force."""

    __tablename__ = "approvals"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=True)
    cell: Mapped[str] = mapped_column(String(64), index=True)
    model: Mapped[str] = mapped_column(ForeignKey("models.id"))
    at: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    by: Mapped[str] = mapped_column(Text)
    how: Mapped[str] = mapped_column(String(10))
    """accept, auto or restore."""


class IdempotencyRow(Base):
    """Idempotency keys and what they were used for."""

    __tablename__ = "idempotency"
    cell: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    body_sha256: Mapped[str] = mapped_column(String(64))
    run: Mapped[str] = mapped_column(ForeignKey("runs.id"))
    created: Mapped[datetime] = mapped_column(DateTime(timezone=True))
