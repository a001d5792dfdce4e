"""``Table``: named columns of numbers from a foreign file, before a map gives them meaning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from invid.errors import InputError
from invid.numerics.arrays import Float64, Int64


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
    """

    name: str
    columns: Mapping[str, Float64]
    lines: Int64 | None = None
    line_word: str = "row"
    notes: Mapping[str, Any] = field(default_factory=dict)
    broken: tuple[BrokenRow, ...] = ()
    rows_seen: int = 0
    units: Mapping[str, str] = field(default_factory=dict)
    stamped: frozenset[str] = frozenset()
    clocks: Mapping[str, str] = field(default_factory=dict)
    reasons: tuple[str, ...] = ()

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
