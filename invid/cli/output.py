"""What a command prints: results on stdout, everything else on stderr."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

EXIT_OK = 0
EXIT_NOT_TRUSTWORTHY = 3


def note(text: str) -> None:
    """Print a line for the person, on stderr."""
    print(text, file=sys.stderr, flush=True)


def emit(document: Mapping[str, Any], text: str, *, as_json: bool) -> None:
    """Print the command's result on stdout: the JSON document alone, or the text for a person."""
    from invid.model.document import dump_json

    sys.stdout.write(dump_json(document) if as_json else text.rstrip("\n") + "\n")
    sys.stdout.flush()
