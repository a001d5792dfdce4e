"""``invid demo``: measure, identify and diagnose a simulated three-axis cell."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.output import emit


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def demo(
        out: Path = typer.Option(Path("invid-demo"), "--out", help="Folder for the results."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Measure, identify and diagnose a simulated three-axis cell; truth beside estimate."""
        from invid_drivers.demo import run_demo

        document, text, status = run_demo(out)
        emit(document, text, as_json=as_json)
        return status
