"""How a delimited text is written: separator (by clevercsv), signs in its numbers, header, instants."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import clevercsv
import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.clock import best_clock, is_count
from invid.recording.import_map import Source
from invid.recording.units import BY_CONSTANT, FACTORS, normal_unit

DELIMITERS = [";", "\t", ",", "|", " "]
SELDOM = 0.01
"""Share of rows with one cell more from which the others have left it blank: as many may be broken."""
WORDS = 0.9
"""Share of rows with a word from which a column holds words, and no row is broken by one."""
SMOOTHER = 2.0
"""How much less numbers must leap with thousands before these are thought of: 998 and 1.002 leap by
a thousand."""
_SNIFFED = 100
"""Lines that clevercsv is shown: its time grows with them, its answer does not change."""
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?$")
_FORMATS = {
    (decimal, thousands): re.compile(
        rf"(?=.*\d)[+-]?(?:\d{{1,3}}(?:{group}\d{{3}})+|\d*)(?:{re.escape(decimal)}\d*)?(?:[eEdD][+-]?\d+)?$"
    )
    for thousands, group in {
        None: "(?!)",
        ",": ",",
        ".": r"\.",
        " ": "[ \u00a0\u2009\u202f]",
        "'": "['’]",
    }.items()
    for decimal in ".,"
    if decimal != thousands
}
"""Ways to write numbers, decimals and the sign between thousands: of several that fit alike the first."""
NOT_A_NUMBER = {"nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none", ""}
_DAYS = (
    "",
    "%Y-%m-%d ",
    "%Y/%m/%d ",
    "%Y.%m.%d ",
    "%d.%m.%Y ",
    "%m/%d/%Y ",
    "%d/%m/%Y ",
    "%d-%b-%Y ",
    "%d %b %Y ",
)
FORMATS = tuple(
    f"{day}{clock}"
    for day in _DAYS
    for clock in ("%H:%M:%S%.f", "%H:%M:%S%.f%#z", "%I:%M:%S%.f %p", "%H:%M", "%I:%M %p")
)
"""Instants as chrono writes them: dates and times of day; 1/2/2026 is the second of January."""
_INSTANT = re.compile(
    r"\d{1,4}[-/.: ][\w:/.-]+[ T]?[\d:.,]*(\s*[AaPp]\.?[Mm]\.?)?(\s*(Z|UTC|[+-]\d\d:?\d\d))?$"
)


@dataclass(frozen=True)
class Dialect:
    """How to read the rows of a text, and what its columns are called."""

    delimiter: str
    decimal: str
    thousands: str | None
    first: int
    """Lines above the first row."""
    names: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    words: frozenset[int] = frozenset()
    """Columns that hold words or instants in the middle of the file."""
    clocks: Mapping[str, str] = field(default_factory=dict)
    rows: int | None = None
    """Where the table ends before the file does."""


def is_numeral(cell: str) -> bool:
    """Whether a cell is a number in some way of writing."""
    return any(form.match(cell) for form in _FORMATS.values())


def is_instant(cell: str) -> bool:
    """Whether a cell looks like a date, a time of day, or both."""
    return (":" in cell or "-" in cell[1:]) and bool(_INSTANT.match(cell)) and not NUMBER.match(cell)


def is_value(cell: str) -> bool:
    """Whether a cell is a number or an instant."""
    return is_numeral(cell) or is_instant(cell)


def split_cells(line: str, delimiter: str) -> list[str]:
    """Cells of a line; a separator inside quotation marks separates nothing, one at the end is habit."""
    if delimiter == " ":
        return line.split()
    if delimiter != ",":
        # A spreadsheet that took the file for comma-separated leaves empty cells at the end of the line.
        line = line.rstrip().rstrip(",")
    cells = [
        c.strip().strip('"').strip()
        for c in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    ]
    return cells[:-1] if len(cells) > 1 and cells[-1] == "" else cells


def find_dialect(head: Sequence[str], middle: Sequence[str], source: Source, where: str) -> Dialect:
    """The dialect of a text by its first lines and lines from its middle.

    Raises
    ------
    InputError
        No row of numbers; numbers that can be read in two ways.
    """
    body = [line for line in middle if not is_remark(line)]
    if not body:
        raise InputError(f"{where}: holds no row of data; is it the right file?", code="no_data")
    delimiter = source.delimiter or find_delimiter(body)
    rows = [split_cells(line, delimiter) for line in body]
    widths = Counter(map(len, rows))
    width = widths.most_common(1)[0][0]
    # The last column may be blank in most rows: a value that is logged at a slower rate.
    width += delimiter != " " and widths[width + 1] > SELDOM * len(rows)
    whole = [[*r, ""][:width] for r in rows if len(r) in (width, width - 1)]
    columns = list(zip(*whole, strict=True))
    words = frozenset(i for i, c in enumerate(columns) if _is_of(is_word, c))
    numbers = [c for i, c in enumerate(columns) if i not in words]
    decimal, thousands = find_number_format(numbers, source.decimal, source.thousands, where)
    first = source.header_lines
    if first is None:
        first = _first_row(head, delimiter, columns, where)
    dialect = Dialect(delimiter, decimal, thousands, first, (), words=words)
    names, units = _names(head[:first], dialect, columns, source.names, where)
    return replace(dialect, names=names, units=units)


def is_remark(line: str) -> bool:
    """Whether a line is empty, a comment, or without any digit: no row of data."""
    return not line.strip() or line.lstrip().startswith(("#", "%", "//")) or not re.search(r"\d", line)


def find_delimiter(body: Sequence[str]) -> str:
    """The separator of lines of data."""
    found = clevercsv.Detector().detect("\n".join(body[:_SNIFFED]), delimiters=DELIMITERS)
    return found.delimiter if found is not None and found.delimiter else ","


def is_word(cell: str) -> bool:
    """Whether a cell is neither a number nor one that is missing."""
    return not is_numeral(cell) and cell.lower() not in NOT_A_NUMBER


def _is_of(kind: Callable[[str], bool], column: Sequence[str]) -> bool:
    return sum(map(kind, column)) > WORDS * len(column)


def _first_row(head: Sequence[str], delimiter: str, columns: Sequence[Sequence[str]], where: str) -> int:
    worded = {i for i, c in enumerate(columns) if _is_of(lambda x: is_word(x) and not is_instant(x), c)}
    width = len(columns)
    for i, line in enumerate(head):
        cells = split_cells(line, delimiter)
        if is_remark(line) or len(cells) not in (width, width - 1):
            continue
        cells = [c for k, c in enumerate(cells) if k not in worded]
        if any(map(is_value, cells)) and all(is_value(c) or c.lower() in NOT_A_NUMBER for c in cells):
            # Rows above it that are half numbers are broken rows of data, not header.
            while i > 0 and 2 * sum(map(is_value, split_cells(head[i - 1], delimiter))) >= width:
                i -= 1
            return i
    raise InputError(
        f"{where}: no row of numbers found",
        way_out="give 'delimiter', 'decimal', 'thousands' and 'header_lines' in the map's 'source' (dates "
        "and "
        "times of day are read as instants, with AM or PM where they say so)",
        code="no_data",
    )


def _names(
    header: Sequence[str],
    dialect: Dialect,
    columns: Sequence[Sequence[str]],
    given: Sequence[str] | None,
    where: str,
) -> tuple[tuple[str, ...], dict[str, str]]:
    width = len(columns)
    if given is not None:
        if len(given) != width:
            raise InputError(f"{where}: the map names {len(given)} columns, the file has {width}")
        return tuple(given), {}
    candidates = []
    for line in header:
        cells = split_cells(line.lstrip("#%/"), dialect.delimiter)
        cells += [""] * (dialect.delimiter != " " and len(cells) == width - 1)
        if len(cells) == width and any(c and not NUMBER.match(c) for c in cells):
            candidates.append(cells)
    # The row of units may have its own name in the first cell.
    if candidates and re.fullmatch(r"units?|einheit(en)?", candidates[-1][0].lower()):
        candidates[-1][0] = ""
    units = candidates.pop() if len(candidates) >= 2 and _all_units(candidates[-1]) else []
    names = candidates[-1] if candidates else [""] * width
    numbers = np.array([[_plain_number(x, dialect) for x in c] for c in columns])
    # An unnamed first column is common, and then it is the time, unless its numbers or its unit say no.
    # One that counts rows is what a table's index looks like when it is written out.
    is_time = not (units and normal_unit(units[0]) not in FACTORS["time"]) and best_clock(numbers) == 0
    first = "index" if is_count(numbers[0]) and not units else "time" if is_time else "column0"
    unique = numbered_twice(n or (first if i == 0 else f"column{i}") for i, n in enumerate(names))
    return unique, {n: u.strip("[]()") for n, u in zip(unique, units, strict=False) if u}


def numbered_twice(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those that come again with a number behind them."""
    unique: list[str] = []
    for n in names:
        unique.append(n if n not in unique else f"{n}.{sum(u.split('.')[0] == n for u in unique)}")
    return tuple(unique)


def _all_units(cells: Sequence[str]) -> bool:
    known = {u for table in FACTORS.values() for u in table} | {*BY_CONSTANT, "-", ""}
    return all(normal_unit(c.strip("[]()")) in known for c in cells)


def _plain_number(cell: str, dialect: Dialect) -> float:
    cell = cell.replace(dialect.thousands, "") if dialect.thousands else cell
    try:
        return float(cell.replace(dialect.decimal, "."))
    except ValueError:
        return float("nan")


def find_number_format(
    columns: Iterable[Sequence[str]], decimal: str | None, thousands: str | None, where: str
) -> tuple[str, str | None]:
    """The sign of the decimals and the one between thousands, as far as the map does not give them.

    Raises
    ------
    InputError
        Signs that may stand for decimals as well as between thousands.
    """
    columns = [list(c) for c in columns]
    fitting = {
        form: sum(bool(pattern.match(cell)) for column in columns for cell in column)
        for form, pattern in _FORMATS.items()
        if decimal in (None, form[0]) and thousands in (None, form[1])
    }
    sign, group = max(fitting, key=lambda form: fitting[form])
    doubtful = next(filter(None, (_doubtful(c, sign) for c in columns)), None) if group is None else None
    if doubtful is None or decimal is not None:
        return sign, group
    other = "." if sign == "," else ","
    raise InputError(
        f"{where}: {doubtful!r} may be a number of three decimals or one of thousands",
        way_out=f"write 'thousands: {sign!r}' (decimals are then {other!r}) or 'decimal: {sign!r}' in the "
        "map's 'source'",
        code="doubtful_numbers",
    )


def _doubtful(column: Sequence[str], sign: str) -> str | None:
    """A cell of a column whose numbers with ``sign`` all have three digits after it, and whose values leap
    less with thousands than with decimals."""
    numerals = [c for c in column if NUMBER.match(c)]
    having = [c for c in numerals if sign in c]
    if not having or not all(re.match(rf"[+-]?[1-9]\d{{0,2}}{re.escape(sign)}\d{{3}}$", c) for c in having):
        return None
    as_decimals = np.array([float(c.replace(sign, ".")) for c in numerals])
    as_thousands = np.array([float(c.replace(sign, "")) for c in numerals])
    # Where all have the sign the one is a thousand times the other, and as smooth.
    return having[0] if roughness(as_decimals) > SMOOTHER * roughness(as_thousands) else None


def roughness(values: Float64) -> float:
    """Mean square of a step over the variance."""
    spread = float(np.var(values))
    return float(np.mean(np.diff(values) ** 2)) / spread if spread > 0 and values.size > 2 else 0.0
