"""``invid compare``: which parameters changed beyond their uncertainty."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.api import compare, load_model
from invid.cli.options import SpokenLanguage
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.wording.sentence import say


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("compare")
    def _compare(
        old: Path = typer.Argument(..., help="Model before, or a diagnosis."),
        new: Path = typer.Argument(..., help="Model after, or a diagnosis."),
        tolerance: float = typer.Option(
            20.0, help="Largest ±x in per cent within which a parameter is still called unchanged."
        ),
        alpha: float = typer.Option(0.01, help="Probability of a false 'changed' over all parameters."),
        repeatability: float = typer.Option(
            0.0, help="Standard deviation in per cent between measurements of an unchanged robot."
        ),
        language: SpokenLanguage = "en",
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Which parameters changed beyond their uncertainty, in words and numbers."""
        from invid.comparison.sentences import table

        result = compare(
            load_model(old),
            load_model(new),
            tolerance=tolerance / 100.0,
            alpha=alpha,
            repeatability=repeatability / 100.0,
        )
        for warning in result.warnings:
            note(f"warning: {warning}")
        document = result.to_json()
        if not result.told:
            note("nothing could be told: no parameter has an uncertainty small enough in both models")
            document["warnings"] = [
                *result.warnings,
                "nothing could be told: measure longer or at a higher amplitude, or identify again with a "
                "method that gives standard deviations",
            ]
        emit(
            document,
            "\n".join(
                [
                    say(result.headline, language),
                    "",
                    *(say(s, language) for s in result.sentences),
                    "",
                    table(result.parameters + result.effects),
                ]
            ),
            as_json=as_json,
        )
        return EXIT_OK if result.told else EXIT_NOT_TRUSTWORTHY
