"""Options that several commands take: ``--effects FILE.py``, ``--language``, ``--budget SECONDS``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from invid.errors import InputError
from invid.wording.sentence import LANGUAGES

BUDGET = 60.0
"""Processor seconds that a command may take where nothing else is asked for: what a technician waits beside a
robot."""
Budget = Annotated[
    float,
    typer.Option(
        min=1.0, help="Seconds of processor time after which the best answer so far is given; inf: no end."
    ),
]
Effects = Annotated[
    list[Path] | None,
    typer.Option(
        "--effects",
        metavar="FILE.py",
        help="A cause beside the catalogue's, in a file of its own (repeatable); it runs as Python here.",
    ),
]


def use_effects(context: typer.Context, files: Sequence[Path] | None) -> None:
    """Make the effects of the files known until the running command ends; InputError says what is wrong."""
    if not files:
        return
    from invid.effects.registry import registered_effects

    context.with_resource(registered_effects(list(files)))


def _known(language: str) -> str:
    if language not in LANGUAGES:
        raise InputError(f"--language: {language!r} is not spoken here; one of {', '.join(LANGUAGES)}")
    return language


SpokenLanguage = Annotated[
    str, typer.Option("--language", callback=_known, help="Of the headline and what changed: en or de.")
]
