"""Text exports of TwinCAT Scope: a block of header lines a channel, and one time column for several channels.

The layout is that of the exports in the tests of pytcs (github.com/CagtayFabry/pytcs, TwinCAT 3 Scope 3.4): a
cell of the header that repeats its line's word ("Name", "SampleTime[ms]", …) heads a time column, the cells
after it head the channels of that time; time is in ms, or in 100 ns since 1601 where full time stamps were
chosen; the file may end with "EOF".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.tables import Table

_MARK = "SampleTime[ms]"
_HEADER = 80
"""The channels' block is some 20 lines long and begins below a handful of lines about the export."""
_TICK_MS = 1e-4
_TICKS_FROM = 1e15
"""Milliseconds never reach this (30,000 years); ticks of 100 ns since 1601 passed it in 1604."""

Split = Callable[[str, str], list[str]]
Number = Callable[[str, bool], float]


def is_scope_export(lines: Sequence[str]) -> bool:
    """Return whether the first lines are such a header."""
    return any(line.lstrip('" ').startswith(_MARK) for line in lines[:_HEADER])


def read_scope_export(name: str, lines: Sequence[str], split: Split, number: Number) -> Table:
    """Columns of an export; ``split`` and ``number`` are those of delimited text."""
    mark = next(i for i, line in enumerate(lines) if line.lstrip('" ').startswith(_MARK))
    delimiter = lines[mark].lstrip().lstrip('"')[len(_MARK) :].lstrip('"')[:1] or "\t"
    heads = [i for i in range(mark) if split(lines[i], delimiter)[:1] == ["Name"]]
    if not heads:
        raise InputError(f"{name}: a scope export without a line 'Name' above {_MARK!r}; export it again")
    names = split(lines[heads[-1]], delimiter)
    block = lines[heads[-1] : heads[-1] + _HEADER]
    units = _line("Unit", block, delimiter, split, len(names))
    first = next((i for i in range(mark, len(lines)) if not lines[i].strip()), mark) + 1
    rows = [split(line, delimiter) for line in lines[first:] if line.strip() and line.strip() != "EOF"]
    names = _without_end(names)
    width = len(_without_end(rows[0])) if rows else 0
    if width != len(names):
        raise InputError(
            f"{name}: the scope export names {len(names)} columns, its first row of numbers has {width}; "
            f"where a name holds the separator {delimiter!r}, export it with another separator"
        )
    comma = delimiter != "," and any("," in cell for row in rows[:400] for cell in row)
    data = np.full((len(rows), len(names)), np.nan)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row[: len(names)]):
            data[i, j] = number(cell, comma)
    columns: dict[str, Float64] = {}
    clocks: dict[str, str] = {}
    stated: dict[str, str] = {}
    clock = ""
    for j, channel in enumerate(names):
        count = int(np.flatnonzero(np.isfinite(data[:, j]))[-1]) + 1 if np.isfinite(data[:, j]).any() else 0
        if channel == "Name":
            clock = "time" if not clock else f"time of {names[j + 1] if j + 1 < len(names) else j}"
            values = data[:count, j]
            ticks = count > 0 and float(np.nanmax(values)) > _TICKS_FROM
            columns[clock] = frozen_float((values - values[0]) * _TICK_MS if ticks else values)
            stated[clock] = "ms"
        elif clock:
            key = channel if channel not in columns else f"{channel}.{j}"
            clocks[key] = clock
            columns[key] = frozen_float(data[: columns[clock].size, j])
            unit = units[j].split(" (")[0]
            stated.update({key: unit} if unit and not unit.startswith("(") else {})
    if not clocks:
        raise InputError(f"{name}: the scope export has no time columns; export it with 'Timelines: All'")
    if max(c.size for c in columns.values()) < 2:
        raise InputError(f"{name}: the scope export holds no samples; is it the right file?")
    factors = [_line(f, block, delimiter, split, len(names)) for f in ("ScaleFactor", "Unit ScaleFactor")]
    scaled = [n for j, n in enumerate(names) if n in clocks and any(f[j] not in ("", "1") for f in factors)]
    reasons = ["the file is a text export of TwinCAT Scope"]
    if scaled:
        reasons.append(
            f"a scale factor is stated for {', '.join(scaled)}; whether the numbers hold it already depends "
            f"on 'Scale values before export': compare one with the scope"
        )
    return Table(
        name, columns, line_word="row", units=stated, clocks=clocks,
        reasons=tuple(reasons),
    )  # fmt: skip


def _without_end(cells: list[str]) -> list[str]:
    """Cells without the empty ones that a separator at the end of a line makes."""
    last = max((i for i, cell in enumerate(cells) if cell), default=-1)
    return cells[: last + 1]


def _line(word: str, lines: Sequence[str], delimiter: str, split: Split, width: int) -> list[str]:
    for line in lines:
        cells = split(line, delimiter)
        if cells[:1] == [word]:
            return [*cells, *[""] * width][:width]
    return [""] * width
