"""``invid tune``: gains, notches, feedforward and shaper from a model, in files; never to a drive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from invid.api import tune, write_tuning
from invid.cli.output import EXIT_OK, emit, note
from invid.model.diagnosis_document import load_document
from invid.model.document import load_json
from invid.tuning.page import headline


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("tune")
    def _tune(
        model: Annotated[
            Path,
            typer.Argument(metavar="MODEL.json", help="A model, or a diagnosis: then what is open counts."),
        ],
        output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER", help="Where the files go.")],
        drive: Annotated[
            str | None, typer.Option("--drive", metavar="NAME", help="Also in this drive's own objects.")
        ] = None,
        motors: Annotated[
            Path | None,
            typer.Option("--motors", metavar="MOTORS.yaml", help="Gear and torque constant of each axis."),
        ] = None,
        before: Annotated[
            Path | None,
            typer.Option("--before", metavar="TUNING.json", help="The values in the drives now."),
        ] = None,
        cycle: Annotated[float, typer.Option(help="Cycle of the drives' loops in seconds.")] = 0.001,
        notches: Annotated[int, typer.Option(min=0, max=8, help="At most this many an axis.")] = 2,
        draws: Annotated[int, typer.Option(min=50, max=5000, help="Machines that must keep margins.")] = 200,
        ripple: Annotated[
            float, typer.Option(min=1e-6, help="Per cent of rated torque that counts may make, rms.")
        ] = 1.0,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    ) -> int:
        """Tune a drive's loops on a model and its uncertainty; writes files, never to a drive."""
        source = load_document(model)
        tuned = tune(
            source,
            before=before,
            cycle=cycle,
            notches=notches,
            draws=draws,
            ripple=ripple / 100.0,
        )
        written = write_tuning(tuned, output, drive=drive, motors=motors)
        for text in tuned.remarks:
            note(f"note: {text}")
        files = f"{', '.join(written.files)} in {written.folder}; look at tuning.html first"
        emit(load_json(output / "tuning.json"), f"{headline(tuned)}\n{files}", as_json=as_json)
        return EXIT_OK
