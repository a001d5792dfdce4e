"""Tables. Their history is in ``migrations/``; a test compares the two."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    text,
)


class Moment(TypeDecorator[datetime]):
    """A time in UTC: SQLite forgets the zone of times, and everything is written in UTC."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_result_value(self, value: Any, dialect: Dialect) -> Any:
        """The time with its zone."""
        return value.replace(tzinfo=UTC) if value is not None and value.tzinfo is None else value


METADATA = MetaData()
_ACTIVE = text(
    "state IN ('queued', 'checking', 'awaiting_arm', 'running', 'analysing') AND cell IS NOT NULL "
    "AND mode <> 'upload'"
)
RUNS = Table(
    "runs",
    METADATA,
    Column("id", String(40), primary_key=True),
    Column("cell", String(64), index=True),
    Column("robot", Text, nullable=False),
    Column("mode", String(16), nullable=False),
    Column("axes", JSON, nullable=False),
    Column("simulated", Boolean, nullable=False),
    Column("state", String(20), nullable=False, index=True),
    Column("created", Moment, nullable=False),
    Column("number", Integer, nullable=False, index=True, server_default="0"),
    Column("started", Moment),
    Column("ended", Moment),
    Column("requested_by", Text, nullable=False),
    Column("facts", JSON, nullable=False),
    # One measurement per cell even where two services should ever share a database.
    Index("one_run_per_cell", "cell", unique=True, sqlite_where=_ACTIVE, postgresql_where=_ACTIVE),
)
"""``number`` grows with every start: the order of the history, whatever the clock says. ``facts``: plan,
error, decision, summary, progress at the end."""
EVENTS = Table(
    "events",
    METADATA,
    Column("run", String(40), ForeignKey("runs.id"), primary_key=True),
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    Column("type", String(20), nullable=False),
    Column("data", JSON, nullable=False),
)
"""What a later reader must still see: changes of state."""
ARTEFACTS = Table(
    "artefacts",
    METADATA,
    Column("run", String(40), ForeignKey("runs.id"), primary_key=True),
    Column("kind", String(20), primary_key=True),
    Column("path", Text, nullable=False),
    Column("size", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("created", Moment, nullable=False),
    Column("deleted", Moment),
)
"""Files of a run; ``path`` is relative to the folder of files."""
MODELS = Table(
    "models",
    METADATA,
    Column("id", String(40), primary_key=True),
    Column("cell", String(64), nullable=False, index=True),
    Column("created", Moment, nullable=False),
    Column("mode", String(16), nullable=False),
    Column("document", Text, nullable=False),
)
"""Models identified on a cell, accepted or not, each with the id of its run and its JSON as written."""
APPROVALS = Table(
    "approvals",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("cell", String(64), nullable=False, index=True),
    Column("model", String(40), ForeignKey("models.id"), nullable=False),
    Column("at", Moment, nullable=False),
    Column("by", Text, nullable=False),
    Column("how", String(10), nullable=False),
)
"""The history of accepted models; only ever added to, the newest is in force. ``how``: accept, auto or
restore."""
IDEMPOTENCY = Table(
    "idempotency",
    METADATA,
    Column("cell", String(64), primary_key=True),
    Column("key", String(255), primary_key=True),
    Column("body_sha256", String(64), nullable=False),
    Column("run", String(40), ForeignKey("runs.id"), nullable=False),
    Column("created", Moment, nullable=False),
)
"""Idempotency keys and what they were used for."""
