"""``invid batch``: every recording below a folder identified and diagnosed, resumable."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.identify import parse_masses
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("batch")
    def _batch(
        folder: Path = typer.Argument(..., metavar="FOLDER", help="Every recording below it."),
        results: Path = typer.Option(
            ..., "-o", "--output", metavar="RESULTS", help="Folder for index.csv and the documents."
        ),
        scheduler: str | None = typer.Option(
            None, metavar="ADDRESS", help="A Dask scheduler, as tcp://host:8786. Default: this machine."
        ),
        workers: int | None = typer.Option(
            None, min=1, help="Recordings at once. Default: this machine's cores; two a thread of a cluster."
        ),
        masses: str | None = typer.Option(
            None, help="Masses of each axis, as 3,3,3; or auto. Default: what each recording says."
        ),
        budget: float | None = typer.Option(None, metavar="SECONDS", help="Time for each recording."),
        as_json: bool = typer.Option(False, "--json", help="Print one JSON document."),
    ) -> int:
        """Identify and diagnose every recording below a folder; run the same again to go on."""
        from invid.batch.analysis import Options
        from invid.batch.batch import run_batch

        if budget is not None and not budget > 0:
            raise InputError(f"--budget {budget:g}: must be above 0")
        options = Options(parse_masses(masses), budget)
        try:
            report = run_batch(folder, results, options, scheduler=scheduler, workers=workers, told=note)
        except KeyboardInterrupt:
            note("interrupted; the same command goes on where this one was")
            raise
        document = report.to_json()
        count = f"{report.done} of {len(report.outcomes)}"
        lines = [f"{count} recordings done in {report.seconds:.1f} s: {report.index}"]
        lines += [f"failed: {text}" for text in document["warnings"]]
        emit(document, "\n".join(lines), as_json=as_json)
        return EXIT_OK if report.done else EXIT_NOT_TRUSTWORTHY
