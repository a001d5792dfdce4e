"""``--effects FILE.py``: causes beside the catalogue's, for one command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

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
