"""Before hardware moves, a person says that the stop is within reach and that people are out."""

from __future__ import annotations

import sys

from invid.cli.output import note
from invid.config import CellConfig
from invid.errors import InputError

WORDS = "the emergency stop is within reach and nobody is within reach of the axes"


def confirm(cell: CellConfig, *, confirmed: bool) -> None:
    """Ask on the terminal, unless it was confirmed on the command line or no hardware stands behind the cell.

    Raises
    ------
    InputError
        The answer was not yes, or there is no terminal to ask on.
    """
    if cell.simulated or confirmed:
        return
    axes = ", ".join(a.name for a in cell.axes)
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError(
            f"measure: {cell.robot} will move ({axes}), and there is no terminal to ask whether {WORDS}; "
            "where that is so, add --confirmed"
        )
    note(f"{cell.robot} will move: {axes}. Confirm that {WORDS}. Type yes to go on:")
    try:
        answer = sys.stdin.readline()
    except KeyboardInterrupt:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError(f"measure: not confirmed that {WORDS}; nothing was opened and nothing moved")
