"""Tables from delimited text: any separator, any header, decimal point or comma, broken rows counted."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, Int64
from invid.recording.clock import best_clock, is_count
from invid.recording.import_map import Source
from invid.recording.readers.scope_export import is_scope_export, read_scope_export
from invid.recording.tables import BrokenRow, Table
from invid.recording.text_format import NUMBER, NumberFormat, decode_text, find_number_format, is_numeral
from invid.recording.units import BY_MACHINE, FACTORS, normal_unit

MAX_BYTES = 2_000_000_000
_DELIMITERS = (";", "\t", ",", "|", " ")
SELDOM = 0.01
"""Share of rows with one cell more from which the others have left it blank: as many may be broken."""
WORDS = 0.9
"""Share of rows with a word from which a column holds words, and no row is broken by one."""
_BLOCK = 1 << 20
"""Bytes that are read at once: more take more memory and no less time."""
_FAILED = 1000
"""Cells that could not be read and are kept to find out why."""
_OF_JOINTS = re.compile(r"(^|[^a-z])(joint_?)?names?_?\d*$|^joint$")
_LIST = re.compile(r"\"?\[([-+.\deE, ]+)\]\"?")
"""A list in a cell, ``"[0.1, 0.2]"``."""
_NOT_A_NUMBER = {"nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none", ""}


def read_text_table(path: Path, source: Source) -> Table:
    """Columns of a text file; what ``source`` leaves open is found out and noted."""
    plain = _plain_table(path, source)
    if plain is not None:
        return plain
    text, encoding = read_text(path, source.encoding)
    lines = text.splitlines()
    del text  # as large as the file
    return table_of_lines(path, lines, source, encoding)


def _plain_table(path: Path, source: Source) -> Table | None:
    """Columns of a large file whose every row is plain numbers, in blocks, as its head and middle say to
    read it; ``None`` for another file."""
    size = path.stat().st_size
    if size < 2 * _BLOCK or find_spec("pyarrow") is None:
        return None
    with path.open("rb") as raw:
        head = raw.read(_BLOCK).rpartition(b"\n")[0]
        raw.seek(size // 2)
        middle = raw.read(_BLOCK).partition(b"\n")[2].rpartition(b"\n")[0]
    try:
        text, encoding = decode_text(head + b"\n" + middle, source.encoding, str(path))
        sample = table_of_lines(path, text.replace("\r", "").split("\n"), source, encoding)
    except InputError:
        return None  # said of the whole file
    if sample.lines is None or sample.stamped or sample.broken or "thousands" in sample.notes:
        return None
    first, form = int(sample.lines[0]) - 1, (sample.notes["delimiter"], sample.notes["decimal"])
    data = _numbers_of(path, first, len(sample.columns), form)
    if data is None:
        return None
    numbers = np.arange(first + 1, first + 1 + data.shape[1], dtype=np.int64)
    return replace(sample, columns=dict(zip(sample.columns, data, strict=True)), lines=numbers)


def _numbers_of(path: Path, first: int, width: int, form: tuple[str, str]) -> Float64 | None:
    """(width, rows) plain numbers of the lines from ``first``; ``None`` where one is something else."""
    delimiter, decimal = form
    if delimiter == " ":
        return None
    rows, last = -first, b""
    with path.open("rb") as raw:
        while block := raw.read(_BLOCK):
            rows, last = rows + block.count(b"\n"), block[-1:]
    data, at = np.empty((width, rows + (last != b"\n"))), 0
    arrow, names = import_module("pyarrow.csv"), [str(i) for i in range(width)]
    try:
        for batch in arrow.open_csv(
            path,
            read_options=arrow.ReadOptions(
                column_names=names, skip_rows=first, use_threads=False, block_size=_BLOCK
            ),
            parse_options=arrow.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(
                column_types=dict.fromkeys(names, "float64"), decimal_point=decimal, null_values=[]
            ),
        ):
            for column, values in zip(data, batch.columns, strict=True):
                column[at : at + batch.num_rows] = values
            at += batch.num_rows
    except ValueError:
        return None
    return data if at == data.shape[1] else None


def table_of_lines(path: Path, lines: list[str], source: Source, encoding: str = "utf-8") -> Table:
    """Columns of the lines of a text file."""
    if source.header_lines is None and source.names is None and is_scope_export(lines):
        return read_scope_export(str(path), lines, _split, _scope_number)
    lines = _lists_written_out(lines)
    numbered = _Numbered(lines, _lines_kept(lines, source.header_lines))
    if not len(numbered):
        raise InputError(f"{path}: holds no row of data; is it the right file?")
    delimiter = source.delimiter or _find_delimiter(numbered, source.decimal)
    widths = Counter(len(_cells(line, delimiter)) for _, line in numbered[-5000:])
    width = widths.most_common(1)[0][0]
    # The last column may be blank in most rows: a value that is logged at a slower rate.
    width += delimiter != " " and widths[width + 1] > SELDOM * sum(widths.values())
    sample = [_cells(line, delimiter) for _, line in (*numbered[:400], *_middle(numbered))]
    form = find_number_format(
        zip(*(row for row in sample if len(row) == width), strict=True),
        source.decimal, source.thousands, str(path),
    )  # fmt: skip
    if source.header_lines is not None:
        header, start = lines[: source.header_lines], 0
    else:
        start = _first_data_row(numbered, delimiter, width, form, path)
        header = lines[: int(numbered.at[start])]
    body = _Body(numbered[start:], delimiter, width)
    data, broken, form = body.parse(form, source, path)
    names, units = _names(header, delimiter, data, source.names, path)
    _one_joint_a_column(names, numbered[start:], delimiter, path)
    stamped = _timestamps(data, [_cells(line, delimiter) for _, line in body.lines[:5]])
    units |= {names[i]: "s" for i in stamped}
    said = {"delimiter": delimiter, "decimal": form.decimal, "header_lines": int(numbered.at[start])}
    said |= {"thousands": form.thousands} if form.thousands else {}
    said |= {"encoding": encoding} if encoding != "utf-8" else {}
    return Table(
        name=str(path),
        columns={name: np.ascontiguousarray(data[:, i]) for i, name in enumerate(names)},
        lines=body.lines.at + 1,
        line_word="line",
        notes=said,
        broken=broken,
        units=units,
        stamped=frozenset(names[i] for i in stamped),
    )


def _lines_kept(lines: list[str], header_lines: int | None) -> Int64:
    """Places of the lines that are neither empty nor a remark."""
    first, aside = header_lines or 0, () if header_lines is not None else ("#", "%", "//")
    if {line[:1] for line in lines}.isdisjoint({"", " ", "\t", "\ufeff", *(a[0] for a in aside)}):
        return np.arange(first, len(lines), dtype=np.int64)
    kept = (i for i in range(first, len(lines)) if (s := lines[i].lstrip()) and not s.startswith(aside))
    return np.fromiter(kept, np.int64)


def _one_joint_a_column(names: list[str], body: _Numbered, delimiter: str, path: Path) -> None:
    """InputError where a column names the joint of a row, and names several."""
    at = [i for i, n in enumerate(names) if _OF_JOINTS.search(n.lower())]
    rows = [_cells(line, delimiter) for _, line in body[:_FAILED]] if at else []
    for i in at:
        said = Counter(r[i] for r in rows if len(r) == len(names) and not _is_value(r[i]) and r[i])
        if len(said) > 1:
            shown = ", ".join(sorted(said)[:4])
            raise InputError(
                f"{path}: {names[i]!r} changes from row to row ({shown}): the numbers beside it are of "
                "several joints in one column; write a table with a column a joint (pandas: "
                f"df.pivot(index=…, columns={names[i]!r}), each time once), or give the MCAP"
            )


def _lists_written_out(lines: list[str]) -> list[str]:
    """Lines with a cell an entry where cells hold lists, each named by its place."""
    first = next((line for line in lines[1:50] if _LIST.search(line)), None)
    if first is None:
        return lines
    delimiter = ";" if lines[0].count(";") > lines[0].count(",") else ","
    header, cells = _split(lines[0], delimiter), _split(first, delimiter)
    named = [
        [f"{name}[{i}]" for i in range(len(found[1].replace(",", " ").split()))] if found else [name]
        for name, cell in zip(header, cells, strict=False)
        if (found := _LIST.fullmatch(cell)) or True
    ]
    apart = [_LIST.sub(lambda m: delimiter.join(m[1].replace(",", " ").split()), line) for line in lines[1:]]
    return [delimiter.join(n for group in named for n in group), *apart]


@dataclass(frozen=True, eq=False)
class _Numbered:
    """Lines ``at`` these places of a file with their numbers, from 1; pairs kept would double the memory."""

    file: list[str]
    at: Int64

    def __len__(self) -> int:
        return int(self.at.size)

    def __getitem__(self, part: slice) -> _Numbered:
        return _Numbered(self.file, self.at[part])

    def texts(self) -> list[str]:
        """The lines alone."""
        first, last = int(self.at[0]), int(self.at[-1])
        whole = last - first + 1 == self.at.size
        return self.file[first : last + 1] if whole else [self.file[i] for i in self.at.tolist()]

    def __iter__(self) -> Iterator[tuple[int, str]]:
        return ((int(i) + 1, self.file[i]) for i in self.at)


def _middle(numbered: _Numbered) -> _Numbered:
    return numbered[len(numbered) // 2 :][:400]


def _timestamps(data: Float64, sample: list[list[str]]) -> list[int]:
    """Columns that hold instants, already seconds."""
    found = []
    for i in range(data.shape[1]):
        cells = [row[i] for row in sample if i < len(row)]
        if any(not is_numeral(c) and not math.isnan(seconds_of(c)) for c in cells):
            found.append(i)
    return found


def read_text(path: Path, encoding: str | None) -> tuple[str, str]:
    """The text of a file and its encoding: the one given, else what it is found to be."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes of text are more than this program reads")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not raw.strip():
        raise InputError(f"{path}: the file is empty")
    return decode_text(raw, encoding, str(path))


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if delimiter != ",":
        # A spreadsheet that took the file for comma-separated leaves empty cells at the end of the line.
        line = line.rstrip().rstrip(",")
    cells = _split(line, delimiter)
    # A separator at the end of every line is habit, not a column.
    return cells[:-1] if len(cells) > 1 and cells[-1] == "" else cells


def _split(line: str, delimiter: str) -> list[str]:
    """Cells of a line; a separator inside quotation marks separates nothing."""
    if '"' in line:
        try:
            return [
                cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
            ]
        except (csv.Error, StopIteration):
            pass
    return [cell.strip().strip('"').strip() for cell in line.split(delimiter)]


def _value(cell: str, form: NumberFormat) -> float:
    """A number, or an instant as seconds; NaN where the cell holds neither."""
    value = form.number(cell)
    return seconds_of(cell) if math.isnan(value) else value


def _scope_number(cell: str, comma: bool) -> float:
    return _value(cell, NumberFormat("," if comma else "."))


def _is_value(cell: str) -> bool:
    return is_numeral(cell) or not math.isnan(seconds_of(cell))


def _find_delimiter(numbered: _Numbered, decimal: str | None) -> str:
    """The separator that splits the body into the most columns of numbers, evenly."""
    body = _middle(numbered).texts()
    best, best_score = ",", -1.0
    for delimiter in _DELIMITERS:
        rows = [_cells(line, delimiter) for line in body]
        width, count = Counter(len(r) for r in rows).most_common(1)[0]
        if width < 2:
            continue
        numeric = [sum(_is_value(c) for c in r) / len(r) for r in rows if len(r) == width]
        # A decimal comma makes ',' split numbers too; where another separator works it is the right one.
        score = count / len(body) * float(np.mean(numeric)) - (0.05 if delimiter == "," else 0.0)
        score -= 0.5 if delimiter == decimal else 0.0
        if score > best_score + 1e-9:
            best, best_score = delimiter, score
    return best


def _first_data_row(numbered: _Numbered, delimiter: str, width: int, form: NumberFormat, path: Path) -> int:
    words = _columns_of_words([_cells(line, delimiter) for _, line in _middle(numbered)], width, form)
    for i, (_, line) in enumerate(numbered):
        cells = _cells(line, delimiter)
        if len(cells) != width:
            continue
        cells = [c for k, c in enumerate(cells) if k not in words]
        values = [not math.isnan(_value(c, form)) for c in cells]
        if any(values) and all(v or c.lower() in _NOT_A_NUMBER for v, c in zip(values, cells, strict=True)):
            # Rows above it that are half numbers are broken rows of data, not header.
            while i > 0 and _half_numbers(_cells(numbered.file[numbered.at[i - 1]], delimiter), width, form):
                i -= 1
            return i
    raise InputError(
        f"{path}: no row of numbers found; give 'delimiter', 'decimal', 'thousands' and 'header_lines' in "
        "the map's 'source' (dates and times of day are read as instants, with AM or PM where they say so)"
    )


def _columns_of_words(rows: list[list[str]], width: int, form: NumberFormat) -> set[int]:
    """Columns that hold words in the middle of the file: names of joints, states of a drive, frames."""
    whole = [r for r in rows if len(r) == width]
    return {
        i for i in range(width) if whole and sum(_is_word(r[i], form) for r in whole) > WORDS * len(whole)
    }


def _is_word(cell: str, form: NumberFormat) -> bool:
    return cell.lower() not in _NOT_A_NUMBER and math.isnan(_value(cell, form))


def _half_numbers(cells: list[str], width: int, form: NumberFormat) -> bool:
    return len(cells) == width and 2 * sum(not math.isnan(_value(c, form)) for c in cells) >= width


def _names(
    header: list[str], delimiter: str, data: Float64, given: list[str] | None, path: Path
) -> tuple[list[str], dict[str, str]]:
    width = data.shape[1]
    if given is not None:
        if len(given) != width:
            raise InputError(f"{path}: the map names {len(given)} columns, the file has {width}")
        return given, {}
    candidates = []
    for line in header:
        line = line if delimiter == "," else line.rstrip().rstrip(",")
        # Keep a leading separator: an unnamed first column is common (it is the time).
        cells = line.lstrip("#%/ ").split() if delimiter == " " else _split(line.lstrip("#%"), delimiter)
        cells = cells[:-1] if len(cells) == width + 1 and cells[-1] == "" else cells
        if len(cells) == width and any(c and not NUMBER.match(c) for c in cells):
            candidates.append(cells)
    units: list[str] = []
    # The row of units may have its own name in the first cell.
    if candidates and re.fullmatch(r"units?|einheit(en)?", candidates[-1][0].lower()):
        candidates[-1][0] = ""
    if len(candidates) >= 2 and _all_units(candidates[-1]):
        units = candidates.pop()
    names = candidates[-1] if candidates else [""] * width
    # An unnamed first column is common, and then it is the time, unless its numbers or its unit say no.
    # One that counts rows is what a table's index looks like when it is written out.
    is_time = not (units and normal_unit(units[0]) not in FACTORS["time"]) and best_clock(data.T) == 0
    first = "index" if is_count(data[:, 0]) and not units else "time" if is_time else "column0"
    names = [n or (first if i == 0 else f"column{i}") for i, n in enumerate(names)]
    unique: list[str] = []
    for n in names:
        unique.append(n if n not in unique else f"{n}.{sum(u.split('.')[0] == n for u in unique)}")
    return unique, dict(zip(unique, [u.strip("[]()") for u in units], strict=True)) if units else {}


def _all_units(cells: list[str]) -> bool:
    known = {u for table in FACTORS.values() for u in table} | {*BY_MACHINE, "-", ""}
    return all(normal_unit(c.strip("[]()")) in known for c in cells)


@dataclass(frozen=True)
class _Body:
    """The lines of data, with their numbers."""

    lines: _Numbered
    delimiter: str
    width: int

    def parse(
        self, form: NumberFormat, source: Source, path: Path
    ) -> tuple[Float64, tuple[BrokenRow, ...], NumberFormat]:
        """(n, width) numbers; NaN where a cell holds none. Rows of another width are broken at once."""
        at_once = self._evenly(form)
        if at_once is not None:
            return at_once, (), form
        data, broken, failed = self._cell_by_cell(form, path.name)
        if failed and form.thousands is None:
            # Thousands may come first where the sample did not look.
            own = find_number_format([failed], form.decimal, source.thousands, str(path))
            if own != form:
                form = own
                data, broken, _ = self._cell_by_cell(form, path.name)
        return data, broken, form

    def _evenly(self, form: NumberFormat) -> Float64 | None:
        """Return the numbers of a file without an empty cell, a date or a broken row; ``None`` for
        another file.
        """
        if form.thousands is not None or (form.decimal == "," and self.delimiter == ","):
            return None
        lines = self.lines.texts()
        if form.decimal == ",":
            lines = [line.replace(",", ".") for line in lines]
        delimiter = None if self.delimiter == " " else self.delimiter
        try:
            data = np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        return data if data.shape == (len(lines), self.width) else None

    def _cell_by_cell(
        self, form: NumberFormat, name: str
    ) -> tuple[Float64, tuple[BrokenRow, ...], list[str]]:
        data = np.full((len(self.lines), self.width), np.nan)
        broken: list[BrokenRow] = []
        failed: list[str] = []
        for row, (number, line) in enumerate(self.lines):
            cells = _cells(line, self.delimiter)
            # A missing last cell was taken for a separator at the end of the line.
            if len(cells) not in (self.width, self.width - 1):
                broken.append(BrokenRow(name, number, f"{len(cells)} cells instead of {self.width}"))
                continue
            for i, cell in enumerate(cells):
                data[row, i] = _value(cell, form)
                if math.isnan(data[row, i]) and len(failed) < _FAILED and is_numeral(cell):
                    failed.append(cell)
        return data, tuple(broken), failed


_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(:(?P<s>\d{2})([.,:](?P<f>\d{1,9}))?)?(\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_DATE = (
    r"((?P<Y>\d{4})[-/.](?P<M>\d{1,2})[-/.](?P<D>\d{1,2})"
    r"|(?P<d1>\d{1,2})(?P<sep>[./])(?P<d2>\d{1,2})[./](?P<Y2>\d{4})"
    r"|(?P<d3>\d{1,2})[- ](?P<word>[A-Za-z]{3})[a-z]*[- ](?P<Y3>\d{4}))"
)
_ZONE = r"\s*(?P<z>Z|UTC|[+-]\d{2}:?\d{2})?"
_INSTANT = re.compile(rf"({_DATE}[T ]\s*)?{_CLOCK}{_ZONE}$|{_DATE.replace('?P<', '?P<o')}$")


def seconds_of(cell: str) -> float:
    """Seconds since 1970 of a date with time (or a date alone), since midnight of a time of day; NaN else.

    An instant without zone counts as UTC: only differences matter. 1.2.2026 is the first of February,
    1/2/2026 the second of January. After 12:59 PM comes 1:00 PM.
    """
    if ":" not in cell and cell.count(".") + cell.count("/") + cell.count("-") + cell.count(" ") < 2:
        return math.nan
    found = _INSTANT.match(cell)
    if found is None:
        return math.nan
    part = found.groupdict()
    hours = int(part["h"] or 0)
    if part["half"]:
        if not 1 <= hours <= 12:
            return math.nan
        hours = hours % 12 + 12 * (part["half"] in "Pp")
    clock = hours * 3600.0 + int(part["m"] or 0) * 60.0 + int(part["s"] or 0)
    clock += float(f"0.{part['f']}") if part["f"] else 0.0
    own = {k: part[k] or part["o" + k] for k in ("Y", "M", "D", "d1", "sep", "d2", "Y2", "d3", "word", "Y3")}
    try:
        day = _day(own)
    except ValueError:
        return math.nan
    return clock if day is None else day + clock - _zone(part["z"])


def _day(part: dict[str, str]) -> float | None:
    """Seconds since 1970 at the start of a date; ``None`` without one, ValueError for no such day."""
    if part["Y"]:
        year, month, day = int(part["Y"]), int(part["M"]), int(part["D"])
    elif part["Y2"]:
        first, second, year = int(part["d1"]), int(part["d2"]), int(part["Y2"])
        month, day = (first, second) if part["sep"] == "/" and first <= 12 else (second, first)
    elif part["Y3"]:
        year, month, day = int(part["Y3"]), _MONTHS.index(part["word"].lower()) + 1, int(part["d3"])
    else:
        return None
    return datetime(year, month, day, tzinfo=UTC).timestamp()


def _zone(text: str | None) -> float:
    if text is None or text in ("Z", "UTC"):
        return 0.0
    digits = text[1:].replace(":", "")
    return (-1.0 if text[0] == "-" else 1.0) * (int(digits[:2]) * 3600.0 + int(digits[2:]) * 60.0)
