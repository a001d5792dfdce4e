"""Rows of delimited text by polars: plain numbers at once, what is no plain number a second time as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import polars as pl

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64
from invid.recording.readers.text_dialect import FORMATS, Dialect, is_remark, split_cells
from invid.recording.tables import BrokenRow, Table

_BEYOND = "beyond"
_SPACES = "[ \u00a0\u2009\u202f]"
_TRIED = 200
"""Cells by which the format of instants is found."""


@dataclass(frozen=True)
class Text:
    """A text that polars can read: the file itself, or its lines rewritten in UTF-8."""

    path: Path
    rewritten: bytes | None = None
    has_quotes: bool = True

    @property
    def origin(self) -> Path | bytes:
        """What polars is given."""
        return self.path if self.rewritten is None else self.rewritten

    def lines_at(self, numbers: Sequence[int]) -> dict[int, str]:
        """The lines of these numbers from 0, increasing."""
        if self.rewritten is not None:
            lines = self.rewritten.split(b"\n")
            return {n: lines[n].decode("utf-8", "replace") for n in numbers}
        with self.path.open("rb") as raw:
            steps = np.diff(numbers, prepend=-1) - 1
            found = [next(islice(raw, int(s), None), b"") for s in steps]
        return {n: line.decode("utf-8", "replace") for n, line in zip(numbers, found, strict=True)}


def read_rows(text: Text, dialect: Dialect) -> Table:
    """The columns of a text; NaN where a cell holds no number, instants as seconds.

    Raises
    ------
    InputError
        No row, or quotation marks that do not close.
    """
    where = str(text.path)
    try:
        frame = _scan(text, dialect, frozenset()).collect(engine="streaming")
        inside = [str(i) for i in range(len(dialect.names))]
        numbers = [n for n in inside if frame.schema[n] == pl.Float64]
        holed = [n for n in numbers if dialect.thousands or frame[n].null_count()]
        if holed:
            frame = _scan(text, dialect, frozenset(holed)).collect(engine="streaming")
    except pl.exceptions.PolarsError as error:
        said = (str(error).splitlines() or [""])[0][:160]
        raise InputError(
            f"{where}: cannot be read as delimited text: {said}",
            way_out="name its 'kind', or its 'delimiter', in the map's 'source'",
            code="unreadable",
        ) from None
    nothing: Bool = np.zeros(frame.height, dtype=np.bool_)
    if holed or not numbers:
        empty = pl.all_horizontal(pl.col(numbers or inside).is_null())
        nothing = frame.select(empty).to_series().to_numpy()
    if not frame.height or bool(nothing.all()):
        raise InputError(f"{where}: holds no row of data; is it the right file?", code="no_data")
    kept, broken = _broken(text, dialect, frame, nothing)
    columns: dict[str, Float64] = {}
    stamped = set()
    for name, key in zip(dialect.names, inside, strict=True):
        column = frame[key]
        if column.dtype == pl.String:
            seconds = seconds_of(column)
            stamped |= {name} if seconds is not None else set()
            column = pl.Series([None] * frame.height, dtype=pl.Float64) if seconds is None else seconds
        values = column.to_numpy()
        columns[name] = values if kept.all() else values[kept]
    lines = np.flatnonzero(kept) + dialect.first + 1
    wrong = np.isin(lines, [b.line for b in broken]) if broken else None
    if wrong is not None:
        columns = {n: np.where(wrong, np.nan, c) for n, c in columns.items()}
    return Table(
        name=where, columns=columns, lines=lines, line_word="line", broken=broken,
        notes={"delimiter": dialect.delimiter},
        units={**dialect.units, **dict.fromkeys(stamped, "s")}, stamped=frozenset(stamped),
    )  # fmt: skip


def _scan(text: Text, dialect: Dialect, as_text: frozenset[str]) -> pl.LazyFrame:
    """The rows; numbers of the columns ``as_text`` by what people write, not by what polars reads."""
    names = [str(i) for i in range(len(dialect.names))]
    worded = {str(i) for i in dialect.words} | as_text
    schema: dict[str, type[pl.DataType]] = {n: pl.String if n in worded else pl.Float64 for n in names}
    frame = pl.scan_csv(
        text.origin,
        has_header=False,
        skip_lines=dialect.first,
        n_rows=dialect.rows,
        separator=dialect.delimiter,
        quote_char='"' if text.has_quotes else None,
        # A row of more cells than there are columns is told by this one.
        schema=schema | {_BEYOND: pl.String},
        missing_columns="insert",
        truncate_ragged_lines=True,
        ignore_errors=True,
        decimal_comma=dialect.decimal == "," and dialect.delimiter != ",",
        encoding="utf8-lossy",
        glob=False,
    )
    return frame.with_columns(_number(pl.col(n), dialect) for n in names if n in as_text)


def _number(cell: pl.Expr, dialect: Dialect) -> pl.Expr:
    """A number as people write it: with blanks, thousands, Fortran's D, a minus as it is printed."""
    cell = cell.str.strip_chars(' \t"\u00a0').str.replace_all("\u2212", "-", literal=True)
    if dialect.delimiter != ",":
        cell = cell.str.strip_chars_end(",")
    if dialect.thousands is not None:
        sign = {" ": _SPACES, "'": "['’]", ".": r"\."}.get(dialect.thousands, dialect.thousands)
        grouped = rf"^[+-]?\d{{1,3}}({sign}\d{{3}})+(\{dialect.decimal}\d+)?$"
        bare = cell.str.replace_all(sign, "")
        plain = rf"^[^{dialect.thousands}]*$"
        cell = pl.when(cell.str.contains(grouped)).then(bare).when(cell.str.contains(plain)).then(cell)
    if dialect.decimal == ",":
        cell = cell.str.replace(",", ".", literal=True)
    return cell.str.replace(r"^([+-]?[\d.]+)[dD]([+-]?\d+)$", "${1}e${2}").cast(pl.Float64, strict=False)


def _broken(
    text: Text, dialect: Dialect, frame: pl.DataFrame, nothing: Bool
) -> tuple[Bool, tuple[BrokenRow, ...]]:
    """Rows that are data or meant to be, and those of them that are broken at once."""
    width = len(dialect.names)
    long = frame[_BEYOND].is_not_null() & (frame[_BEYOND] != "")
    doubtful = (frame["0"].is_null() | long).to_numpy() | nothing
    kept: Bool = np.ones(frame.height, dtype=np.bool_)
    broken = []
    numbers = (np.flatnonzero(doubtful) + dialect.first).tolist()
    for row, line in zip(np.flatnonzero(doubtful).tolist(), text.lines_at(numbers).values(), strict=True):
        if is_remark(line):
            kept[row] = False
            continue
        cells = len(split_cells(line, dialect.delimiter))
        if long[row] or (nothing[row] and cells not in (width, width - 1)):
            broken.append(
                BrokenRow(text.path.name, dialect.first + row + 1, f"{cells} cells instead of {width}")
            )
    return kept, tuple(broken)


def seconds_of(cells: pl.Series) -> pl.Series | None:
    """Seconds since 1970 of dates with time, since midnight of times of day; ``None`` of what is neither.

    An instant without zone counts as UTC: only differences matter.
    """
    # 12:36:19,001 and 12:36:19:001 are 12:36:19.001; 1 p.m. is 1 PM.
    cells = cells.str.strip_chars(" \"'").str.replace(r"^(.*\d{1,2}:\d{2}:\d{2})[,:](\d+)", "${1}.${2}")
    cells = cells.str.replace(r"(\d{4}[-/.]\d{1,2}[-/.]\d{1,2})T", "${1} ").str.replace(
        r"\s?(Z|UTC)$", "+00:00"
    )
    cells = cells.str.replace(r"(?i)\s*([ap])\.?m\.?$", " ${1}m").str.to_uppercase()
    first = cells.drop_nulls().head(_TRIED)
    known = first.filter(first.str.contains(r"\d"))
    for form in FORMATS if known.len() else ():
        if _parsed(known, form).null_count() == 0:
            return _parsed(cells, form)
    return None


def _parsed(cells: pl.Series, form: str) -> pl.Series:
    if form.startswith(("%H", "%I")) and "%#z" not in form:
        cells, form = "1970-01-01 " + cells, f"%Y-%m-%d {form}"
    if form.endswith("%#z"):
        found = cells.str.to_datetime(form, strict=False, time_unit="ns", time_zone="UTC")
    else:
        found = cells.str.to_datetime(form, strict=False, time_unit="ns")
    return found.dt.timestamp("ns").cast(pl.Float64) * 1e-9
