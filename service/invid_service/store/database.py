"""Open the database, SQLite in WAL mode or PostgreSQL, and bring it to the newest schema by Alembic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from invid.errors import ConfigError

BUSY_S = 2.0
"""A locked SQLite answers "busy" after this; a person waits that long for a page, not longer."""


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
            engine = create_engine(parsed, connect_args={"timeout": BUSY_S, "check_same_thread": False})
            event.listen(engine, "connect", _configure_sqlite)
        else:
            engine = create_engine(parsed, pool_pre_ping=True, pool_timeout=5)
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
    """Bring the schema to the newest version; ConfigError where the database cannot be used."""
    try:
        command.upgrade(migrations_config(engine), "head")
    except SQLAlchemyError as error:
        shown = engine.url.render_as_string(hide_password=True)
        raise ConfigError(f"store {shown}: cannot be opened: {str(error).splitlines()[0]}") from None
