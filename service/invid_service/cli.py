"""``invid serve``: the REST service and the technician's page."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.output import note
from invid.errors import ConfigError


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("serve", help="Serve the REST interface and the technician's page.")
    def serve(
        config: list[Path] = typer.Argument(
            None, help="Config of each cell; without one the simulated case study."
        ),
        host: str = typer.Option(None, help="Address to bind; beyond loopback a key is needed."),
        port: int = typer.Option(None, min=0, max=65535, help="Port; 0 takes a free one."),
        data_dir: Path = typer.Option(None, help="Folder of the store; default .invid."),
        key_file: Path = typer.Option(None, help="File with the hashed keys."),
        add_key: str = typer.Option(
            None, metavar="NAME:SCOPES", help="Add a key to --key-file, print it once and end."
        ),
        database_url: str = typer.Option(None, help="SQLAlchemy URL instead of SQLite in the data folder."),
        json_logs: bool = typer.Option(False, "--json-logs", help="Logs as JSON lines."),
    ) -> None:
        if add_key is not None:
            _add_key(key_file, add_key)
            return
        from invid_service.serving import serve_forever, settings_from

        given = {
            "cells": config or None,
            "host": host,
            "port": port,
            "data_dir": data_dir,
            "key_file": key_file,
            "database_url": database_url,
        }
        settings = settings_from({k: v for k, v in given.items() if v is not None})
        serve_forever(settings, json_logs=json_logs)


def _add_key(key_file: Path | None, text: str) -> None:
    from invid_service.auth import add_key

    if key_file is None:
        raise ConfigError("--add-key needs --key-file: the file the key's hash is added to")
    name, _, scopes = text.partition(":")
    token = add_key(key_file, name, [s.strip() for s in scopes.split(",") if s.strip()])
    note(f"added {name!r} to {key_file}; the key is shown this once:")
    typer.echo(token)
