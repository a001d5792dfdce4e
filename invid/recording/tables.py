"""``Table``: named columns of numbers from a foreign file, on one clock, without broken rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, Int64, frozen_float


@dataclass(frozen=True)
class BrokenRow:
    """A row that was skipped; ``line`` counts from 1 in a text file, else it is the row from 0."""

    file: str
    line: int
    reason: str


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file.

    Attributes
    ----------
    columns
        Name → (n,) values; NaN where a cell held no number. Columns may differ in length.
    lines
        (n,) line (or row) number of each row, for messages.
    notes
        What was found out about the file (delimiter, decimal sign, header), for ``--suggest``.
    texts
        ``(row, column) → text`` of cells that are no number, as far as they were kept.
    units
        Column → unit as the file's own header states it.
    stamped
        Columns that held dates or times of day, read as seconds.
    clocks
        Column → the time column it was sampled by, where a file has several; else empty.
    reasons
        What the reader found out about the file, in words, for ``--suggest``.
    sums
        Time column → its stamps added up over everything the file stamps, where rows are only some of it.
    """

    name: str
    columns: Mapping[str, Float64]
    lines: Int64 | None = None
    line_word: str = "row"
    notes: Mapping[str, Any] = field(default_factory=dict)
    broken: tuple[BrokenRow, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    stamped: frozenset[str] = frozenset()
    clocks: Mapping[str, str] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    sums: Mapping[str, Float64] = field(default_factory=dict)

    def column(self, key: str | int) -> Float64:
        """One column by name or index; InputError lists what there is."""
        names = list(self.columns)
        if isinstance(key, int):
            if not 0 <= key < len(names):
                raise InputError(f"{self.name}: no column {key}; the file has {len(names)} columns")
            return self.columns[names[key]]
        if key not in self.columns:
            close = [n for n in names if n.lower().strip() == key.lower().strip()]
            if len(close) == 1:
                return self.columns[close[0]]
            raise InputError(f"{self.name}: no column {key!r}; found {shorten(names)}")
        return self.columns[key]


def shorten(names: list[str], most: int = 24) -> str:
    """A list of names for a message."""
    shown = ", ".join(repr(n) for n in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


BROKEN_LIMIT = 0.01
"""More broken rows than this stop an import: it is then more likely a wrong map than a bad log (issue 7)."""


def good_rows(
    table: Table, needed: Sequence[str | int], instants: Float64 | None, inside: Bool, path: Path
) -> tuple[Bool, list[BrokenRow]]:
    """Mask of usable rows among those ``inside`` and the others with their reason.

    ``instants`` [s] are those of all rows, None where rows are counted. InputError beyond one per cent.
    """
    columns = {name: table.column(name) for name in needed}
    sizes = {c.size for c in columns.values()}
    if len(sizes) != 1:
        found = ", ".join(f"{n!r} {c.size}" for n, c in columns.items())
        raise InputError(f"{path}: the columns of the map differ in length: {found}")
    good: Bool = inside.copy()
    count = int(inside.sum())
    reasons: dict[int, str] = {}
    for name, column in columns.items():
        for row in np.flatnonzero(~np.isfinite(column) & good).tolist():
            good[row] = False
            reasons[row] = f"column {name!r} holds no number"
    if instants is not None:
        for row in _out_of_order(instants, good):
            good[row] = False
            reasons[row] = "time does not increase"
    known = {b.line: b.reason for b in table.broken}
    numbers: Int64 = np.arange(good.size, dtype=np.int64) if table.lines is None else table.lines
    skipped = [
        BrokenRow(path.name, int(numbers[row]), known.get(int(numbers[row]), reason))
        for row, reason in sorted(reasons.items())
    ]
    # Broken lines of a bus log are no rows of their own: a lost frame shows as a row without a value, and
    # what belongs to no mapped signal is missed by nobody; both are reported, each once.
    own = {int(n) for n in numbers}
    holed = {int(numbers[row]) for row in reasons}
    behind = [int(numbers[max(int(np.searchsorted(numbers, b.line)) - 1, 0)]) for b in table.broken]
    lines = [b for b, row in zip(table.broken, behind, strict=True) if b.line not in own and row not in holed]
    skipped = sorted([*skipped, *lines], key=lambda b: b.line)
    worst = max(len(reasons), len(lines))
    if worst > BROKEN_LIMIT * count or good.sum() < 2:
        shown = "; ".join(f"{table.line_word} {b.line}: {b.reason}" for b in skipped[:5])
        raise InputError(
            f"{path}: {worst} of {count} rows are broken, more than {BROKEN_LIMIT:.0%} ({shown}"
            f"{'; …' if len(skipped) > 5 else ''}); check the map's {_keys(table)}, or repair the file"
        )
    return good, skipped


def _keys(table: Table) -> str:
    """The keys of a map that decide how such a file is read."""
    if "delimiter" in table.notes:
        return "columns, 'delimiter', 'decimal' and 'thousands'"
    return "'pdos' and 'sync_id'" if "sync_id" in table.notes else "columns"


def _out_of_order(time: Float64, good: Bool) -> list[int]:
    rows = np.flatnonzero(good)
    t = time[rows]
    if rows.size < 2 or (np.diff(t) > 0).all():
        return []
    bad: list[int] = []
    last = -np.inf
    for i, row in enumerate(rows):
        # A lone instant far ahead would make every later row look late: it is the one that is wrong.
        leap = i + 1 < rows.size and last < t[i + 1] < t[i] and (i + 2 >= rows.size or t[i + 2] < t[i])
        if t[i] <= last or leap:
            bad.append(int(row))
        else:
            last = t[i]
    return bad


def on_clock(table: Table, time: str, needed: Sequence[str]) -> tuple[Table, tuple[str, ...]]:
    """The table at the instants of one of its time columns, with a remark for each column moved there.

    Parameters
    ----------
    table
        With ``clocks``: which time column each column was sampled by.
    time
        The time column to keep.
    needed
        Columns that must be there. Those of other clocks are interpolated linearly, never beyond their ends:
        the rows kept are those that all of them cover.

    Raises
    ------
    InputError
        Columns that have no instant in common.
    """
    instants = table.columns[time]
    own = {n: c for n, c in table.columns.items() if table.clocks.get(n, time) == time}
    moved = [n for n in dict.fromkeys(needed) if n not in own]
    keep: Bool = np.isfinite(instants)
    remarks = []
    brought: dict[str, Float64] = {}
    for name in moved:
        clock = table.clocks[name]
        there, values = table.columns[clock], table.columns[name]
        good = np.isfinite(there) & np.isfinite(values)
        good[1:] &= there[1:] > np.maximum.accumulate(there)[:-1]
        if good.sum() < 2:
            raise InputError(f"{table.name}: column {name!r} has fewer than two samples that follow in time")
        there, values = there[good], values[good]
        keep &= (instants >= there[0]) & (instants <= there[-1])
        brought[name] = np.interp(instants, there, values)
        remarks.append(
            f"{name!r} was sampled at instants of its own ({clock!r}, {_interval(there)}); it was "
            f"interpolated to those of {time!r} ({_interval(instants)})"
        )
    if moved and keep.sum() < 2:
        raise InputError(f"{table.name}: {time!r} and the instants of {moved} have no time in common")
    rows = keep if moved else np.ones(instants.size, dtype=np.bool_)
    columns = {n: frozen_float(c[rows]) for n, c in (own | brought).items() if c.size == rows.size}
    lines = np.arange(rows.size, dtype=np.int64) if table.lines is None else table.lines[: rows.size]
    same = dict.fromkeys(columns, time)
    return replace(table, columns=columns, lines=lines[rows], clocks=same), tuple(remarks)


def _interval(instants: Float64) -> str:
    return f"every {float(np.median(np.diff(instants[np.isfinite(instants)]))):.4g}"
