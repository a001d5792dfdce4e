"""Rows of a foreign table that can be used, and the broken ones with their numbers and reasons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, Int64
from invid.recording.tables import BrokenRow, Table

BROKEN_LIMIT = 0.01
"""More broken rows than this stop an import: it is then more likely a wrong map than a bad log (issue 7)."""


def good_rows(
    table: Table, needed: Sequence[str | int], time: str | int | None, path: Path
) -> tuple[Bool, list[BrokenRow]]:
    """Mask of usable rows and the others with their reason; InputError beyond one per cent."""
    columns = {name: table.column(name) for name in needed}
    sizes = {c.size for c in columns.values()}
    if len(sizes) != 1:
        found = ", ".join(f"{n!r} {c.size}" for n, c in columns.items())
        raise InputError(f"{path}: the columns of the map differ in length: {found}")
    count = sizes.pop()
    good: Bool = np.ones(count, dtype=np.bool_)
    reasons: dict[int, str] = {}
    for name, column in columns.items():
        for row in np.flatnonzero(~np.isfinite(column) & good).tolist():
            good[row] = False
            reasons[row] = f"column {name!r} holds no number"
    if time is not None:
        for row in _out_of_order(columns[time], good):
            good[row] = False
            reasons[row] = "time does not increase"
    known = {b.line: b.reason for b in table.broken}
    numbers: Int64 = np.arange(count, dtype=np.int64) if table.lines is None else table.lines
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
            f"{'; …' if len(skipped) > 5 else ''}); check the map's columns, 'delimiter' and 'decimal', "
            f"or repair the file"
        )
    return good, skipped


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
