"""``invid effects``: a law without a name written as an effect file."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.api import load_diagnosis
from invid.cli.output import EXIT_OK, emit, note
from invid.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command."""
    group = typer.Typer(no_args_is_help=True, help="Causes in files of their own.")

    @group.command("new")
    def _new(
        name: str = typer.Argument(..., help="Name of the cause, as churned_oil."),
        source: Path = typer.Option(
            ..., "--from", metavar="DIAGNOSIS.json", help="Diagnosis with such a law."
        ),
        axis: str | None = typer.Option(
            None, "--axis", help="Axis of the law; needed where there are several."
        ),
        output: Path | None = typer.Option(None, "-o", "--output", help="File to write. Default: NAME.py."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Write a law without a name as an effect file: diagnose … --effects NAME.py finds it by its name."""
        from invid.effects.effect_files import load_effects
        from invid.effects.law_file import law_file
        from invid.model.document import save_text

        laws = [e for e in load_diagnosis(source).model.effects if e.table is not None]
        chosen = [e for e in laws if axis in (None, e.axis)]
        if len(chosen) != 1:
            known = ", ".join(e.axis for e in laws) or "none"
            raise InputError(f"{source}: it holds laws without a name on: {known}; choose one with --axis")
        path = Path(f"{name}.py") if output is None else output
        save_text(path, law_file(name, chosen[0]))
        load_effects(path)
        note(f"{path} written; say in it what the cause is, and give it to diagnose with --effects {path}")
        emit({"file": str(path), "cause": name}, str(path), as_json=as_json)
        return EXIT_OK

    app.add_typer(group, name="effects")
