"""``invid replay``: the results of a bundle worked out again, offline, and what differs."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.bundle import load
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.errors import InputError

SHOWN = 20


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("replay")
    def _replay(
        bundle: Path = typer.Argument(..., metavar="BUNDLE.zip", help="What invid bundle wrote."),
        trust: Path | None = typer.Option(
            None, metavar="KEY.pem.pub", help="Refuse what another key signed."
        ),
        tolerance: float = typer.Option(0.0, help="Relative difference that a number may have."),
        as_json: bool = typer.Option(False, "--json", help="Print one JSON document."),
    ) -> int:
        """Check a bundle, work every number out again, and say what differs."""
        if not 0.0 <= tolerance < 1.0:
            raise InputError(f"--tolerance {tolerance:g}: give a fraction from 0 up to 1")
        done = load("invid.bundle.replay").replay(bundle, trust=trust, tolerance=tolerance)
        if not done.trusted:
            note(f"whole and signed by {done.signer}; --trust says whether that key is the right one")
        for text in done.missing:
            note(f"not in the bundle: {text}")
        for text in done.packages:
            note(f"another version: {text}")
        lines = [f"{done.numbers} numbers worked out again, {done.identical} the same to the last bit"]
        if done.differences:
            lines.append(f"{len(done.differences)} entries differ by more than {done.tolerance:g}")
            lines += [f"  {d.sentence}" for d in done.differences[:SHOWN]]
            if len(done.differences) > SHOWN:
                lines.append(f"  … and {len(done.differences) - SHOWN} more (--json lists all)")
        emit(done.to_json(), "\n".join(lines), as_json=as_json)
        return EXIT_NOT_TRUSTWORTHY if done.differences else EXIT_OK
