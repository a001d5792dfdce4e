"""``Table``: named columns of numbers from a foreign file, on one clock, without broken rows."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

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
    aliases
        Further name → column: a place in a list that has names, where it is always the same one's.
    reasons
        What the reader found out about the file, in words, for ``--suggest``.
    remarks
        What was assumed of the file, in words, for the warnings of an import.
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
    aliases: Mapping[str, str | int] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    sums: Mapping[str, Float64] = field(default_factory=dict)

    def name_of(self, key: str | int) -> str:
        """The column that a map's name or index means; InputError lists what there is."""
        names, key = list(self.columns), self.aliases.get(str(key), key)
        if isinstance(key, int):
            if not 0 <= key < len(names):
                raise InputError(f"{self.name}: no column {key}; the file has {len(names)} columns")
            return names[key]
        close = (
            [key] if key in self.columns else [n for n in names if n.lower().strip() == key.lower().strip()]
        )
        if len(close) != 1:
            raise InputError(f"{self.name}: no column {key!r}; found {shorten(names)}", code="no_column")
        return close[0]

    @property
    def numbers(self) -> Int64:
        """(n,) line of each row, else its number from 0, for messages."""
        longest = max(c.size for c in self.columns.values())
        return np.arange(longest, dtype=np.int64) if self.lines is None else self.lines

    def column(self, key: str | int) -> Float64:
        """One column by name or index."""
        return self.columns[self.name_of(key)]

    def holds(self, key: str | int) -> bool:
        """Whether there is a column of this very name, or an index is given."""
        key = self.aliases.get(str(key), key)
        return isinstance(key, int) or key in self.columns

    def renamed(self, new: Mapping[Any, str | int]) -> Table:
        """The table with columns under other names: the map's → the one to read instead."""
        meant = {str(key): self.aliases.get(str(name), name) for key, name in new.items()}
        return replace(self, aliases={**self.aliases, **meant})


def with_whole_stamps(table: Table) -> Table:
    """The table with ``stamp`` [s] beside each ``stamp.sec`` and ``stamp.nanosec``, as ROS writes them."""
    columns, units = dict(table.columns), dict(table.units)
    for name, whole in table.columns.items():
        found = re.fullmatch(r"(.*?)[._/]?(s|secs?|seconds)", name)
        stem = found[1] if found else ""
        for part in (f"{name[: len(name) - len(found[2])]}{n}" for n in _NANO) if found else ():
            if part in table.columns and stem not in table.columns and table.columns[part].size == whole.size:
                columns[stem or "stamp"] = frozen_float(whole + 1e-9 * table.columns[part])
                units[stem or "stamp"] = "s"
    return replace(table, columns=columns, units=units)


_NANO = ("nanosec", "nanosecs", "nsec", "nsecs", "nanoseconds", "ns")


def shorten(names: list[str], most: int = 24) -> str:
    """A list of names for a message."""
    shown = ", ".join(repr(n) for n in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


BROKEN_LIMIT = 0.01
"""More broken rows than this stop an import: it is then more likely a wrong map than a bad log (issue 7)."""

SPARSE = 0.75
"""Share of rows with a number up to which a column has a rate of its own."""
LONGEST_BLANK = 20.0
"""Rows between two numbers, over the usual, up to which a column is taken for one of a slower rate."""


def good_rows(
    table: Table, needed: Sequence[str], instants: Float64, inside: Bool, path: Path
) -> tuple[Bool, list[BrokenRow]]:
    """Mask of usable rows among those ``inside``, by the columns ``needed`` and ``instants`` (n,) [s], and
    the others with their reason. InputError beyond one per cent.
    """
    columns = {n: table.columns[n] for n in needed}
    good: Bool = inside.copy()
    count = int(inside.sum())
    reasons: dict[int, str] = {}
    for name, column in columns.items():
        wrong = np.flatnonzero(~np.isfinite(column) & good)
        reasons |= dict.fromkeys(wrong.tolist(), f"column {name!r} holds no number")
        good[wrong] = False
    late = _out_of_order(instants, good)
    reasons |= dict.fromkeys(late, "time does not increase")
    good[late] = False
    known = {b.line: b.reason for b in table.broken}
    numbers = table.numbers
    skipped = [
        BrokenRow(path.name, int(numbers[row]), known.get(int(numbers[row]), reason))
        for row, reason in sorted(reasons.items())
    ]
    # Broken lines of a bus log are no rows of their own: a lost frame shows as a row without a value, and
    # what belongs to no mapped signal is missed by nobody; both are reported, each once.
    holed = {int(numbers[row]) for row in reasons}
    lines = []
    for b, at in zip(table.broken, np.searchsorted(numbers, [b.line for b in table.broken]), strict=True):
        around = numbers[max(at - 1, 0) : at + 1].tolist()
        if b.line not in around and around[0] not in holed:
            lines.append(b)
    skipped = sorted([*skipped, *lines], key=lambda b: b.line)
    worst = max(len(reasons), len(lines))
    if worst > BROKEN_LIMIT * count or good.sum() < 2:
        shown = "; ".join(f"{table.line_word} {b.line}: {b.reason}" for b in skipped[:5])
        raise InputError(
            f"{path}: {worst} of {count} rows are broken, more than {BROKEN_LIMIT:.0%} ({shown}"
            f"{'; …' if len(skipped) > 5 else ''})",
            way_out=f"check the map's {_keys(table)}, or repair the file",
            code="broken_rows",
            values={"broken": worst, "rows": count},
        )
    return good, skipped


@dataclass(frozen=True, eq=False)
class SlowestRows:
    """A table at the rows of its slowest column: ``rows`` (n,) of the file, of which each stands for ``each``
    on the mean; what was left out and interpolated, in a sentence."""

    table: Table
    rows: Int64
    each: float = 1.0
    remark: str = ""


def at_slowest(
    table: Table, time: str | int | None, needed: Sequence[str], words: Collection[str]
) -> SlowestRows:
    """The table at the rows of the slowest of the columns ``needed``; at all where each has a number in most.

    Columns with numbers in other rows are interpolated to these: the other way round a slow position would
    move in straight lines, with all its acceleration at the corners. Of ``words``, numbers that mean their
    bits, the last one known is kept.
    """
    columns = {n: table.columns[n] for n in needed}
    size = max(c.size for c in columns.values())
    known = {n: np.flatnonzero(np.isfinite(c)) for n, c in columns.items()}
    slow = min(known, key=lambda n: known[n].size)
    at = known[slow]
    moved = [n for n, c in columns.items() if at.size and np.isfinite(c[at]).mean() <= 1.0 - BROKEN_LIMIT]
    # Blanks that come at no rate are broken rows, not a second rate.
    is_slow = 16 <= at.size <= SPARSE * size
    if not is_slow or any(known[n].size < 2 or _has_blank(known[n], size) for n in (slow, *moved)):
        return SlowestRows(table, np.arange(size))
    apart = np.diff(at)
    usual, mean = float(np.median(apart)), float(apart.mean())
    each = usual if abs(mean / usual - 1.0) < 0.02 else mean
    remark = f"{slow!r} has a number in every {each:.3g} rows only: the rows between are left out"
    remark += f", and {', '.join(map(repr, moved))} interpolated to its rows" if moved else ""
    for name in moved:
        at = at[(at >= known[name][0]) & (at <= known[name][-1])]
    order = np.arange(size, dtype=np.float64) if time is None else table.column(time)
    order = order if bool((np.diff(order) > 0).all()) else np.arange(size, dtype=np.float64)
    found = {n: c[at] for n, c in table.columns.items() if c.size == size}
    for name in moved:
        own, values = known[name], columns[name]
        # Straight lines take 3 % of what moves at a 25th of the rate; a cubic spline 0.01 %.
        line = scipy.interpolate.make_interp_spline(order[own], values[own], k=min(3, own.size - 1))
        last = values[own[np.searchsorted(own, at, side="right") - 1]]
        found[name] = last if name in words else line(order[at])
    lines, sums = table.numbers[at], {n: c[at] for n, c in table.sums.items()}
    left_out = set(table.numbers.tolist()).difference(lines.tolist())
    broken = tuple(b for b in table.broken if b.line not in left_out)
    return SlowestRows(replace(table, columns=found, lines=lines, sums=sums, broken=broken), at, each, remark)


def _has_blank(rows: np.typing.NDArray[np.intp], size: int) -> bool:
    """Whether the largest step between row numbers and to the ends of ``size`` rows is far over the usual."""
    apart = np.diff(rows, prepend=-1, append=size)
    return bool(apart.max() > LONGEST_BLANK * np.median(apart))


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


def each_once(clocks: Mapping[str, str], columns: Mapping[str, Float64]) -> dict[str, str]:
    """Column → clock with one clock of those that are the same stamps: the first."""
    first: dict[str, str] = {}
    for clock in clocks.values():
        same = (c for c in first.values() if np.array_equal(columns[c], columns[clock]))
        first[clock] = next(same, clock)
    return {name: first[clock] for name, clock in clocks.items()}


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
    clocks = {n: table.clocks.get(n, time) for n in table.columns}
    moved = [n for n in dict.fromkeys(needed) if clocks[n] != time]
    found = {n: c for n, c in table.columns.items() if clocks[n] == time and c.size == instants.size}
    keep: Bool = np.isfinite(instants) if moved else np.ones(instants.size, dtype=np.bool_)
    remarks = []
    for name in moved:
        there, values = table.columns[clocks[name]], table.columns[name]
        good = np.isfinite(there) & np.isfinite(values)
        good[1:] &= there[1:] > np.maximum.accumulate(there)[:-1]
        if good.sum() < 2:
            raise InputError(f"{table.name}: column {name!r} has fewer than two samples that follow in time")
        there, values = there[good], values[good]
        keep &= (instants >= there[0]) & (instants <= there[-1])
        found[name] = np.interp(instants, there, values)
        if not np.array_equal(there, instants):
            remarks.append(
                f"{name!r} was sampled at instants of its own ({clocks[name]!r}, {_interval(there)}); it was "
                f"interpolated to those of {time!r} ({_interval(instants)})"
            )
    if moved and keep.sum() < 2:
        raise InputError(
            f"{table.name}: {time!r} and the instants of {moved} have no time in common",
            code="no_common_time",
        )
    lines = table.numbers[: keep.size]
    columns = {n: frozen_float(c[keep]) for n, c in found.items()}
    same = dict.fromkeys(columns, time)
    return replace(table, columns=columns, lines=lines[keep], clocks=same), tuple(remarks)


def _interval(instants: Float64) -> str:
    return f"every {float(np.median(np.diff(instants[np.isfinite(instants)]))):.4g}"
