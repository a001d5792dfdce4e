"""``--language``: in which language a command says its headline."""

from __future__ import annotations

from typing import Annotated

import typer

from invid.errors import InputError
from invid.wording.statement import LANGUAGES


def _known(language: str) -> str:
    if language not in LANGUAGES:
        raise InputError(f"--language: {language!r} is not spoken here; one of {', '.join(LANGUAGES)}")
    return language


SpokenLanguage = Annotated[
    str, typer.Option("--language", callback=_known, help="Of the headline and what changed: en or de.")
]
