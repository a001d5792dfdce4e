"""Before hardware moves, a person says that the stop is within reach and that people are out."""

from __future__ import annotations

import sys

from invid.cli.output import note
from invid.config import CellConfig
from invid.errors import InputError
from invid_drivers.readiness import loads_to_support, support_sentence

WORDS = "the emergency stop is within reach and nobody is within reach of the axes"


def confirm(cell: CellConfig, *, confirmed: bool) -> None:
    """Ask on the terminal, unless it was confirmed on the command line or no hardware stands behind the cell.

    Without a terminal there is nobody to ask: whoever had the command started there answers for it, and is
    told so.

    Raises
    ------
    InputError
        The answer was not yes.
    """
    if cell.simulated:
        return
    axes = ", ".join(a.name for a in cell.axes)
    tried = loads_to_support(cell)
    if tried:
        note(f"{cell.robot}: {support_sentence(tried)}")
    if confirmed:
        return
    if sys.stdin is None or not sys.stdin.isatty():
        note(
            f"{cell.robot} will move: {axes}. Nobody could be asked (no terminal): whoever started this "
            f"answers for it that {WORDS} (--confirmed says so)"
        )
        return
    note(f"{cell.robot} will move: {axes}. Confirm that {WORDS}. Type yes to go on:")
    try:
        answer = sys.stdin.readline()
    except KeyboardInterrupt:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError(f"measure: not confirmed that {WORDS}; nothing was opened and nothing moved")
