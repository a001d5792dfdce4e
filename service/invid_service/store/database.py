"""Open the database, SQLite in WAL mode or PostgreSQL, and bring it to the newest schema by Alembic."""

from __future__ import annotations

import json
import logging
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from invid.disk import room
from invid.errors import ConfigError
from invid.model.document import parse_json
from invid.recording.spool import sync_folder
from invid.wording.sentence import with_wording

log = logging.getLogger(__name__)
_AS_JSON: dict[str, Any] = {
    "json_serializer": lambda value: json.dumps(with_wording(value) if isinstance(value, dict) else value),
    "json_deserializer": parse_json,
}
"""Facts and events keep their sentences, so that a run of the store is said in any language."""
_POSTGRESQL_DISK_FULL = "53100"
BUSY_S = 2.0
"""A locked SQLite answers "busy" after this; a person waits that long for a page, not longer."""


def is_full(error: BaseException) -> bool:
    """True where a database says that its disk is full."""
    said = getattr(error, "orig", error)
    return getattr(said, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL or (
        getattr(said, "sqlstate", None) == _POSTGRESQL_DISK_FULL
    )


def open_engine(url: str) -> Engine:
    """Return the engine for ``url``; ConfigError where it names no database we can use."""
    try:
        parsed = make_url(url)
    except ArgumentError:
        raise ConfigError(
            f"database_url: {url!r} is no SQLAlchemy URL; for instance postgresql+psycopg://user@host/invid"
        ) from None
    if parsed.get_backend_name() == "postgresql" and "+" not in parsed.drivername:
        parsed = parsed.set(drivername="postgresql+psycopg")
    try:
        if parsed.get_backend_name() == "sqlite":
            engine = create_engine(
                parsed, connect_args={"timeout": BUSY_S, "check_same_thread": False}, **_AS_JSON
            )
            event.listen(engine, "connect", _configure_sqlite)
        else:
            engine = create_engine(parsed, pool_pre_ping=True, pool_timeout=5, **_AS_JSON)
    except ImportError as error:
        extra = "pip install 'invid[postgres]'" if parsed.get_backend_name() == "postgresql" else "install it"
        raise ConfigError(
            f"database_url: the driver of {parsed.drivername} is not installed ({error}); {extra}"
        ) from None
    except SQLAlchemyError as error:
        raise ConfigError(f"database_url: {parsed.render_as_string()}: {error}") from None
    return engine


def _configure_sqlite(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    # FULL: an answered accept survives a power cut; a run writes a dozen rows, so it costs nothing.
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def migrations_config(engine: Engine) -> Config:
    """Return Alembic's configuration, without a file."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
    config.attributes["engine"] = engine
    return config


def upgrade(engine: Engine) -> None:
    """Bring the schema to the newest version, an SQLite store with a copy of before beside it; ConfigError
    where the database cannot be used.
    """
    shown = engine.url.render_as_string(hide_password=True)
    try:
        config = migrations_config(engine)
        scripts = ScriptDirectory.from_config(config)
        head = scripts.get_current_head()
        with engine.connect() as connection:
            found = MigrationContext.configure(connection).get_current_revision()
        if found not in {None, *(s.revision for s in scripts.walk_revisions())}:
            raise ConfigError(
                f"store {shown}: a newer invid made it (schema {found}; this one knows up to {head}); start "
                "that one, or put back the copy that it made when it took over (how-to/upgrade)"
            )
        if found not in (None, head):
            _keep_as_it_was(engine, shown, found)
        command.upgrade(config, "head")
    except SQLAlchemyError as error:
        where = Path(engine.url.database or "").parent
        more = f"; {room(where)}; make room there, then start again" if is_full(error) else ""
        raise ConfigError(f"store {shown}: cannot be opened: {str(error).splitlines()[0]}{more}") from None


def _keep_as_it_was(engine: Engine, shown: str, schema: str) -> None:
    """Copy an SQLite store before it is migrated; of another database the backup is its owner's."""
    if engine.url.get_backend_name() != "sqlite" or not engine.url.database:
        log.warning(
            "store %s: schema %s is migrated in place; the way back is your own dump of it", shown, schema
        )
        return
    store = Path(engine.url.database)
    copy = store.with_name(f"{store.stem}-schema-{schema}-{datetime.now(UTC):%Y%m%dT%H%M%S}{store.suffix}")
    part = copy.with_name(copy.name + ".part")
    try:
        with closing(engine.raw_connection()) as source, closing(sqlite3.connect(part)) as target:
            source.driver_connection.backup(target)  # type: ignore[union-attr]
        part.replace(copy)
        sync_folder(copy.parent)
    except (sqlite3.Error, OSError) as error:
        part.unlink(missing_ok=True)
        raise ConfigError(
            f"store {shown}: it is migrated with a copy of before beside it, and {part} cannot be written "
            f"({error}); {room(store.parent)}. Nothing was changed: make room, then start again"
        ) from None
    log.info("store %s: schema %s is migrated; as it was it lies in %s", shown, schema, copy)
