"""``invid export``: the identified model for another tool, with its covariance beside it."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.api import export, load_model
from invid.cli.output import EXIT_OK, emit, note


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("export")
    def _export(
        model: Path = typer.Argument(
            ..., metavar="MODEL.json", help="Model, or a diagnosis: the extended one."
        ),
        to: str = typer.Option(..., "--to", help="statespace (MAT file), mjcf, urdf or fmu (FMI 3)."),
        output: Path = typer.Option(..., "-o", "--output", metavar="FILE", help="Where it goes."),
        as_json: bool = typer.Option(False, "--json", help="Print one JSON document."),
    ) -> int:
        """Write a model for another tool, with its covariance and what the format cannot hold beside it."""
        written = export(load_model(model), to, output)
        for text in written.losses:
            note(f"not in the file as it is: {text}")
        for text in written.warnings:
            note(f"warning: {text}")
        lines = [f"{to} written to {written.path}; covariance and losses in {written.beside}"]
        if written.losses:
            lines.append(f"{len(written.losses)} things of the model are not in the file as they are")
        emit(written.to_json(), "\n".join(lines), as_json=as_json)
        return EXIT_OK
