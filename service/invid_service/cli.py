"""``invid serve``: the REST service and the technician's page; ``invid keys``: who may use the service."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import typer

from invid.cli.output import emit, note
from invid_service.keys import add_key, read_keys, revoke_key


def register(app: typer.Typer) -> None:
    """Add the command ``invid serve``."""

    @app.command("serve", help="Serve the REST interface and the technician's page.")
    def serve(
        config: list[Path] = typer.Argument(
            None, help="Config of each cell; without one the simulated case study."
        ),
        host: str = typer.Option(None, help="Address to bind; beyond loopback a key is needed."),
        port: int = typer.Option(None, min=0, max=65535, help="Port; 0 takes a free one."),
        data_dir: Path = typer.Option(None, help="Folder of the store; default .invid."),
        key_file: Path = typer.Option(None, help="File with the hashed keys."),
        database_url: str = typer.Option(None, help="SQLAlchemy URL instead of SQLite in the data folder."),
        root_path: str = typer.Option(
            None, help="Path under which a reverse proxy shows the service: /invid."
        ),
        trusted_proxy: list[str] = typer.Option(
            None, help="Address or network of a reverse proxy whose X-Forwarded-… headers are believed."
        ),
        json_logs: bool = typer.Option(False, "--json-logs", help="Logs as JSON lines."),
    ) -> None:
        from invid_service.serving import serve_forever, settings_from

        given = {
            "cells": config or None,
            "host": host,
            "port": port,
            "data_dir": data_dir,
            "key_file": key_file,
            "database_url": database_url,
            "root_path": root_path,
            "trusted_proxies": trusted_proxy or None,
        }
        settings = settings_from({k: v for k, v in given.items() if v is not None})
        serve_forever(settings, json_logs=json_logs)


def register_keys(app: typer.Typer) -> None:
    """Add the commands ``invid keys …``, which change a key file; a running service follows within a
    second.
    """
    keys = typer.Typer(help="List, add and revoke the keys of the service.", no_args_is_help=True)
    file = typer.Option(..., "--key-file", help="File with the hashed keys.")

    @keys.command("add")
    def add(
        key: str = typer.Argument(
            ..., metavar="NAME:SCOPES", help="As plc:read,run; read, run, accept, admin."
        ),
        key_file: Path = file,
        days: float = typer.Option(None, min=0.001, help="The key ends after so many days."),
    ) -> None:
        """Add a key and print it, this once."""
        name, _, scopes = key.partition(":")
        expires = None if days is None else datetime.now(UTC) + timedelta(days=days)
        wanted = [s.strip() for s in scopes.split(",") if s.strip()]
        token = add_key(key_file, name, wanted, expires=expires)
        note(f"added {name!r} to {key_file}; the key is shown this once:")
        typer.echo(token)

    @keys.command("list")
    def show(
        key_file: Path = file,
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> None:
        """Print id, name, scopes and end of every key; never the key itself."""
        now = datetime.now(UTC)
        rows = [
            {**k.model_dump(mode="json", exclude={"sha256"}), "expired": k.expired(now)}
            for k in read_keys(key_file)
        ]
        lines = [
            f"{r['id']}  {r['name']}  {','.join(r['scopes'])}  "
            + (
                "without end"
                if r["expires"] is None
                else f"{'expired' if r['expired'] else 'until'} {r['expires']}"
            )
            for r in rows
        ]
        emit({"keys": rows}, "\n".join(lines) or f"{key_file}: no keys", as_json=as_json)

    @keys.command("revoke")
    def revoke(
        key: str = typer.Argument(
            ..., metavar="ID", help="Id of the key, or its name where only one has it."
        ),
        key_file: Path = file,
    ) -> None:
        """Take a key out of the file."""
        gone = revoke_key(key_file, key)
        note(f"revoked {gone.id} ({gone.name}); a running service refuses it within a second")

    app.add_typer(keys, name="keys")
