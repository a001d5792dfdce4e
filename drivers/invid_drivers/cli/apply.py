"""``invid apply``: write tuned values into drives, by a person's act, and undo it; ``--undo``.

Nothing else of invid writes gains.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from invid.cli.output import EXIT_OK, emit, note
from invid.config import CellConfig, load_config
from invid.errors import InputError
from invid.model.document import load_json
from invid.tuning.axis_loop import loops_from_json
from invid.tuning.forms import read_motors
from invid_drivers.cia402.journal import Entry
from invid_drivers.values.applying import Change, Proposal, apply, propose, undo


def change_line(change: Change) -> str:
    """One object, old and new."""
    at, values = change.row.at, f"{change.old:.6g} → {change.new:.6g} {change.row.unit}"
    return f"  {change.axis} {at.address} {at.name}: {values}".rstrip()


def require_name(cell: CellConfig, given: str | None, what: str) -> None:
    """Ask for the robot's name on the terminal, unless it was given; InputError where it is another."""
    if given is None and sys.stdin is not None and sys.stdin.isatty():
        note(f"{what} Type the robot's name ({cell.robot}) to go on:")
        given = sys.stdin.readline().strip()
    if given != cell.robot:
        found = "no name was given" if not given else f"found {given!r}"
        raise InputError(
            f"not confirmed: {found}, the robot's name is {cell.robot!r}; nothing was written",
            way_out="a person who has read the list names the robot: --i-confirm NAME",
        )


def _tell(lines: Sequence[str]) -> None:
    for line in lines:
        note(line)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("apply")
    def _apply(
        arguments: Annotated[
            list[Path],
            typer.Argument(metavar="[TUNING.json] CONFIG", help="With --undo the config alone."),
        ],
        motors: Annotated[
            Path | None,
            typer.Option("--motors", metavar="MOTORS.yaml", help="Gear and torque constant of each axis."),
        ] = None,
        name: Annotated[
            str | None,
            typer.Option(
                "--i-confirm", metavar="NAME", help="The robot's name, by a person who read the list."
            ),
        ] = None,
        dry_run: Annotated[bool, typer.Option("--dry-run", help="Show the list; write nothing.")] = False,
        back: Annotated[
            bool, typer.Option("--undo", help="Write back what the last apply replaced.")
        ] = False,
        as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    ) -> int:
        """Write tuned values into drives that are off or stand: a list of old and new, confirmed by name."""
        if len(arguments) != (1 if back else 2):
            raise InputError("apply: give TUNING.json and CONFIG; with --undo CONFIG alone")
        cell = load_config(arguments[-1])
        if back:
            return _undo(cell, name, as_json)
        loops = loops_from_json(load_json(arguments[0]), str(arguments[0]))
        scales = {} if motors is None else read_motors(motors)

        def agree(proposal: Proposal) -> None:
            _tell(
                [change_line(c) for c in proposal.changes]
                or ["nothing changes: the drives hold these values"]
            )
            _tell([f"note: {text}" for text in proposal.said])
            if proposal.changes:
                require_name(cell, name, f"{len(proposal.changes)} objects would be written as listed.")

        if dry_run:
            found = propose(cell, loops, scales)
            lines = [*(change_line(c) for c in found.changes), *(f"note: {text}" for text in found.said)]
            emit({**found.to_json(), "written": False}, "\n".join(lines), as_json=as_json)
            return EXIT_OK
        done = apply(cell, loops, scales, agree)
        text = (
            f"{cell.robot}: {len(done.changes)} objects written and read back; what stood there is kept: "
            "`invid apply --undo` restores it, `invid verify` measures the loops. A drive forgets at "
            "power-off unless its own tool stores it"
        )
        emit({**done.to_json(), "written": bool(done.changes)}, text, as_json=as_json)
        return EXIT_OK


def _undo(cell: CellConfig, name: str | None, as_json: bool) -> int:
    def agree(entries: tuple[Entry, ...]) -> None:
        require_name(cell, name, f"{len(entries)} objects go back to what stood there.")

    count, said = undo(cell, agree)
    _tell([f"note: {text}" for text in said])
    emit(
        {"undone": count, "said": list(said)}, f"{cell.robot}: {count} objects are as before", as_json=as_json
    )
    return EXIT_OK
