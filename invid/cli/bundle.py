"""``invid bundle``: a measurement with all that its results rest on, in one signed file."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.identify import parse_masses
from invid.cli.output import EXIT_OK, emit, note
from invid.errors import InputError

KEY = Path.home() / ".config" / "invid" / "bundle-key.pem"


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("bundle")
    def _bundle(
        recording: Path = typer.Argument(..., metavar="REC.h5", help="The recording."),
        output: Path = typer.Option(..., "-o", "--output", metavar="BUNDLE.zip", help="Where it goes."),
        model: Path | None = typer.Option(None, metavar="MODEL.json", help="Default: identified now."),
        diagnosis: Path | None = typer.Option(None, metavar="DIAGNOSIS.json", help="Default: made now."),
        masses: str | None = typer.Option(None, help="Masses that the model was or is identified with."),
        method: str = typer.Option("refined", help="refined or paper, of the model."),
        frames: list[Path] | None = typer.Option(None, metavar="LOG", help="Raw CAN frames."),
        eds: list[Path] | None = typer.Option(None, metavar="FILE.eds", help="EDS of a drive."),
        drives: Path | None = typer.Option(
            None, metavar="CHECK.json", help="What invid check CONFIG --json printed."
        ),
        lock: Path | None = typer.Option(None, metavar="FILE", help="Lock file of the installation."),
        key: Path = typer.Option(KEY, metavar="KEY.pem", help="Ed25519 key; made where there is none."),
        as_json: bool = typer.Option(False, "--json", help="Print one JSON document."),
    ) -> int:
        """Pack recording, config, EDS, results and versions into one signed file."""
        make = load("invid.bundle.bundle")
        if method not in ("refined", "paper"):
            raise InputError(f"--method {method}: there are refined and paper")
        evidence = make.Evidence(model, diagnosis, lock, drives, tuple(frames or ()), tuple(eds or ()))
        bundled = make.make_bundle(
            recording, output, key, evidence, masses=parse_masses(masses), method=method
        )
        if bundled.key_made:
            note(f"a key was made: {key}; whoever checks bundles needs {key}.pub")
        for text in bundled.missing:
            note(f"not in the bundle: {text}")
        lines = [f"{len(bundled.parts)} parts in {bundled.path}, signed by {bundled.signer[:16]}…"]
        emit(bundled.to_json(), "\n".join(lines), as_json=as_json)
        return EXIT_OK


def load(module: str):  # type: ignore[no-untyped-def]
    """Import a module that needs ``cryptography``; InputError where that is not installed."""
    from importlib import import_module

    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "cryptography":
            raise
        raise InputError("bundles need the package cryptography: pip install 'invid[bundle]'") from None
