"""Before hardware moves, a person says that the stop is within reach and that people are out."""

from __future__ import annotations

import sys

from invid.cli.output import note
from invid.config import CellConfig
from invid.errors import InputError
from invid_drivers.cia402.hold_memory import HoldMemory
from invid_drivers.cia402.holding import to_support
from invid_drivers.cia402.journal import journal_path

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
    tried = to_support(cell, HoldMemory.beside(journal_path(cell.bus.interface, cell.bus.channel)))
    if tried:
        note(
            f"{cell.robot}: how {', '.join(tried)} is held after a stop was not seen yet; where it carries a "
            "load, that is tried first, at rest. Support it so that it cannot fall far and still hangs on "
            "its drive"
        )
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
