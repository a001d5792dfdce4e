"""``invid verify``: measure the drives' loops as they are now and compare with what a tuning predicted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.config import load_config
from invid.model.document import dump_json, load_json, save_text
from invid.recording import read_recording
from invid.tuning.axis_loop import prediction_from_json
from invid.tuning.page import verification_picture, verification_to_json
from invid.tuning.verification import verify
from invid_drivers.cli.measure import confirm
from invid_drivers.measurement import measure_to_file
from invid_drivers.values.closed_loop import AMPLITUDE, closed_loop_config


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("verify")
    def _verify(
        tuning: Annotated[Path, typer.Argument(metavar="TUNING.json", help="What the drives were given.")],
        config: Annotated[Path, typer.Argument(metavar="CONFIG", help="The cell.")],
        output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER", help="Where the files go.")],
        amplitude: Annotated[
            float, typer.Option(min=0.001, max=1.0, help="Torque added, as a share of each axis' limit.")
        ] = AMPLITUDE,
        confirmed: Annotated[
            bool, typer.Option("--confirmed", help="The stop is within reach, nobody is near the axes.")
        ] = False,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    ) -> int:
        """Shake the axes a little while their drives' loops hold them; say whether that is as predicted."""
        model, loops, timing = prediction_from_json(load_json(tuning), str(tuning))
        cell = load_config(config)
        confirm(cell, confirmed=confirmed)
        measured = measure_to_file(closed_loop_config(cell, amplitude), output / "verification.h5")
        for text in measured.warnings:
            note(f"note: {text}")
        found = verify(model, loops, timing, read_recording(measured.path))
        document = verification_to_json(found)
        save_text(output / "verification.json", dump_json(document))
        save_text(output / "verification.svg", verification_picture(found))
        lines = [*document["sentences"], f"verification.json, .svg and .h5 in {output}"]
        if found.verdict.asks_for_undo:
            lines.append("write the old values back with the drives' own tool")
        emit(document, "\n".join(lines), as_json=as_json)
        return EXIT_NOT_TRUSTWORTHY if found.verdict.asks_for_undo else EXIT_OK
