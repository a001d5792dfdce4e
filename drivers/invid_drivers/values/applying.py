"""Tuned values written into drives, only by a person's act, and undone.

A drive is written to that is off, or that stands. What it held goes to a journal of its own on disk before
each write: the next measurement, which undoes what a run left, does not touch it. One act is remembered;
``undo`` writes back what it replaced, where the drive still shows what was written.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from invid.config import CellConfig
from invid.errors import DriveError, InputError
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.motor_scale import MotorScale
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.failures import WriteRefused
from invid_drivers.cia402.journal import Entry, Journal, journal_path
from invid_drivers.cia402.restoration import restore
from invid_drivers.cia402.states import is_energised, state_of
from invid_drivers.connect import connect, is_virtual
from invid_drivers.values.present import Present, read_present
from invid_drivers.values.rows import DRIVES, DriveValue

STAND_S, LOOKS = 0.3, 7
STANDS = 0.01
"""Share of the speed limit below which an axis stands (a convention: a hold's ripple is far below it)."""
SAME = 1e-5
"""Relative difference below which a value is not changed: REAL32 keeps seven digits."""


@dataclass(frozen=True)
class Change:
    """One object of one drive, in the unit of its row."""

    axis: str
    node_id: int
    row: DriveValue
    old: float
    new: float

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        at = {"object": self.row.at.address, "name": self.row.at.name, "unit": self.row.unit}
        return {"axis": self.axis, "node_id": self.node_id, **at, "old": self.old, "new": self.new}


@dataclass(frozen=True)
class Proposal:
    """What would be written, and what of the tuning the drives cannot hold, in sentences."""

    changes: tuple[Change, ...]
    said: tuple[str, ...]

    @property
    def token(self) -> str:
        """Stands for these changes from these values: who agrees to it has seen them."""
        plain = json.dumps([c.to_json() for c in self.changes], sort_keys=True)
        return hashlib.sha256(plain.encode()).hexdigest()[:16]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"changes": [c.to_json() for c in self.changes], "said": list(self.said), "token": self.token}


Agree = Callable[[Proposal], None]
"""Asks a person; raises InputError where the answer is no."""


def propose(config: CellConfig, loops: Mapping[str, AxisLoop], motors: Mapping[str, MotorScale]) -> Proposal:
    """What ``apply`` would write; reads and nothing else.

    Raises
    ------
    InputError, DriveError
        An axis that is not the cell's, a drive without rows, an object whose range is not known or that
        cannot take the value.
    """
    cell = connect(config)
    try:
        cell.listen()
        return _proposal(cell, loops, motors)
    finally:
        cell.close()


def apply(
    config: CellConfig,
    loops: Mapping[str, AxisLoop],
    motors: Mapping[str, MotorScale],
    agree: Agree,
) -> Proposal:
    """Write the changed objects, once a person agrees, and read them back; return what was written.

    Raises
    ------
    InputError
        As ``propose``, and where nobody agreed: nothing was written.
    DriveError, BusError
        A drive under power moves, or did not take a value: what had been written is as it was.
    """
    with _checked(config) as (cell, journal):
        proposal = _proposal(cell, loops, motors)
        agree(proposal)
        named = {c.axis for c in proposal.changes}
        written = [d for d in _with_journal(cell, journal) if d.name in named]
        for drive in written:
            _require_rest(drive, cell)
            journal.forget(drive.node_id)  # one act back
        try:
            for drive in written:
                for change in proposal.changes:
                    if change.axis == drive.name:
                        _write(drive, change)
        except BaseException:
            for drive in written:
                _roll_back(drive)
            raise
        return proposal


def undo(config: CellConfig, agree: Callable[[tuple[Entry, ...]], None]) -> tuple[int, tuple[str, ...]]:
    """Write back what the last ``apply`` replaced; how many objects, and what was left and why.

    Raises
    ------
    InputError
        Nothing is remembered, or nobody agreed.
    DriveError
        A drive under power: nothing is written back into it.
    """
    with _checked(config) as (cell, journal):
        drives = _with_journal(cell, journal)
        entries = tuple(e for d in drives for e in journal.of_node(d.node_id))
        if not entries:
            raise InputError(f"{config.robot}: nothing that was written into its drives is remembered")
        for drive in drives:
            if journal.of_node(drive.node_id) and is_energised(state_of(drive.read(od.STATUSWORD))):
                raise DriveError(
                    f"{drive.who}: under power; switch the axis off (load supported), then undo",
                    axis=drive.name,
                )
        agree(entries)
        said = tuple(s for d in drives for s in restore(d, {d.of_node.number}))
        left = sum(len(journal.of_node(d.node_id)) for d in drives)
        return len(entries) - left, said


def written_entries(config: CellConfig) -> tuple[Entry, ...]:
    """What the last ``apply`` wrote and nobody has undone, by the journal; no drive is asked."""
    path = _journal_path(config)
    return () if path is None or not path.exists() else Journal(path).entries


def _journal_path(config: CellConfig) -> Path | None:
    if not is_virtual(config):
        return journal_path(config.bus.interface, config.bus.channel).with_suffix(".tuned")
    memory = (config.simulation or {}).get("memory")
    return None if memory is None else Path(memory).absolute().with_suffix(".tuned")


@contextmanager
def _checked(config: CellConfig) -> Iterator[tuple[Cia402Cell, Journal]]:
    """The cell, asked as before a measurement, and the journal of tuned values."""
    cell = connect(config)
    try:
        cell.check()
        journal = Journal(_journal_path(config))
        yield cell, journal
        journal.disk.settle()
    finally:
        cell.close()


def _with_journal(cell: Cia402Cell, journal: Journal) -> list[Access]:
    """The drives, written through another journal than that of a run."""
    for drive in cell.drives:
        if drive.of_node.number > 1:
            raise DriveError(
                f"{drive.who}: of a node with several axes no values are written: it is not "
                "known which axis they are of; enter them with its own tool",
                axis=drive.name,
            )
    objects = [row.at for known in DRIVES.values() for row in known.rows]
    return [d.through(journal, objects) for d in cell.drives]


def _proposal(cell: Cia402Cell, loops: Mapping[str, AxisLoop], motors: Mapping[str, MotorScale]) -> Proposal:
    by_axis = {p.axis: (p, d) for p, d in zip(read_present(cell.drives, motors), cell.drives, strict=True)}
    strange = sorted(set(loops) - set(by_axis))
    if strange:
        raise InputError(f"the tuning is for axis {strange[0]!r}; the cell has {sorted(by_axis)}")
    changes: list[Change] = []
    said: list[str] = []
    for axis, loop in loops.items():
        present, drive = by_axis[axis]
        changes += _changes(present, drive, loop, motors)
        said += [f"{axis}: {text}" for text in present.drive.losses] if present.drive else []
    return Proposal(tuple(changes), tuple(dict.fromkeys(said)))


def _changes(
    present: Present, drive: Access, loop: AxisLoop, motors: Mapping[str, MotorScale]
) -> Iterator[Change]:
    known = present.drive
    if known is None:
        raise DriveError(
            f"{drive.who}: no row says which objects of this drive hold its loops",
            way_out="enter the values of tuning.json with the drive's own tool",
            axis=drive.name,
        )
    motor = known.motor(drive.name, motors)
    filters = sum(
        row.at.name.startswith("notch ") and row.at.name.endswith("frequency") for row in known.rows
    )
    if len(loop.gains.notches) > filters:
        raise DriveError(
            f"{drive.who}: the tuning needs {len(loop.gains.notches)} notch filters and {known.name} has "
            f"rows for {filters}: without them its margins do not hold",
            way_out=f"tune with --notches {filters}",
            axis=drive.name,
        )
    for row, old in present.values.items():
        new = float(row.count(row.value(loop, motor)))
        if math.isclose(old, new, rel_tol=SAME):
            continue
        if _most(row, drive) is None:
            raise DriveError(
                f"{drive.who}: the range of {row.at.address} {row.at.name} is not known: it is not written",
                way_out="name the drive's EDS in the config, if it states limits, or enter the values with "
                "its own tool",
                axis=drive.name,
            )
        if not 0.0 <= new <= (_most(row, drive) or 0.0):
            raise InputError(f"{drive.who}: {row.at.address} {row.at.name} cannot take {new:g} {row.unit}")
        yield Change(drive.name, drive.node_id, row, old, new)


def _most(row: DriveValue, drive: Access) -> float | None:
    declared = None if drive.declared is None else drive.declared.find(row.at.index, row.at.sub)
    return row.most if declared is None or declared.high is None else float(declared.high)


def _require_rest(drive: Access, cell: Cia402Cell) -> None:
    """DriveError where a drive under power moves its axis."""
    if not is_energised(state_of(drive.read(od.STATUSWORD))):
        return
    report = next(r for r in cell.reports if r.axis == drive.name)
    seen = []
    for _ in range(LOOKS):
        seen.append(drive.read(od.POSITION))
        cell.link.wait(STAND_S / LOOKS)
    speed = (max(seen) - min(seen)) * report.scaling.position_per_count / STAND_S
    if speed > STANDS * drive.config.limits.velocity:
        raise DriveError(
            f"{drive.who}: under power and not at rest ({speed:.3g}/s); nothing is written into a drive that "
            "moves",
            axis=drive.name,
        )


def _write(drive: Access, change: Change) -> None:
    """Write one object, journal first, and see that the drive shows it."""
    what, data = change.row.at, change.row.pack(change.new)
    drive.replace(what, data)
    shown = drive.peek(what)
    if shown is None or not math.isclose(change.row.unpack(shown), change.new, rel_tol=1e-3, abs_tol=1e-9):
        found = "nothing" if shown is None else f"{change.row.unpack(shown):g}"
        raise DriveError(
            f"{drive.who}: {what.address} {what.name} was written as {change.new:g} and shows {found}; "
            "what had been written is as it was",
            axis=drive.name,
        )


def _roll_back(drive: Access) -> None:
    left: list[Entry] = []
    for entry in drive.journal.of_node(drive.node_id):
        what, before = drive.object_of(entry), bytes.fromhex(entry.before)
        try:
            if drive.peek(what) != before:
                drive.download(what, before)
        except WriteRefused:
            left.insert(0, entry)
    drive.journal.keep(drive.node_id, left)
