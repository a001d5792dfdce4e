"""Tables from delimited text: any separator, any header, decimal point or comma, broken rows counted."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.import_map import Source
from invid.recording.scope_export import is_scope_export, read_scope_export
from invid.recording.tables import BrokenRow, Table
from invid.recording.units import BY_MACHINE, FACTORS, normal_unit

MAX_BYTES = 2_000_000_000
_DELIMITERS = (";", "\t", ",", "|", " ")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?$")
_NOT_A_NUMBER = {"nan", "inf", "+inf", "-inf", "na", "n/a", "null", "none", ""}


def read_text_table(path: Path, source: Source) -> Table:
    """Columns of a text file; what ``source`` leaves open is found out and noted."""
    text = _decode(path, source.encoding)
    lines = text.splitlines()
    if source.header_lines is None and source.names is None and is_scope_export(lines):
        return read_scope_export(str(path), lines, _split, _number)
    numbered = [(i + 1, line) for i, line in enumerate(lines) if line.strip()]
    if source.header_lines is not None:
        numbered = [(n, line) for n, line in numbered if n > source.header_lines]
    else:
        numbered = [(n, line) for n, line in numbered if not line.lstrip().startswith(("#", "%", "//"))]
    if not numbered:
        raise InputError(f"{path}: holds no row of data; is it the right file?")
    delimiter = source.delimiter or _find_delimiter([line for _, line in numbered], source.decimal)
    decimal = source.decimal or _find_decimal([line for _, line in numbered], delimiter)
    rows = [(n, _cells(line, delimiter)) for n, line in numbered]
    width = Counter(len(cells) for _, cells in rows[-5000:]).most_common(1)[0][0]
    if source.header_lines is not None:
        header, start = lines[: source.header_lines], 0
    else:
        start = _first_data_row(rows, width, decimal, path)
        header = lines[: rows[start][0] - 1]
    names, units = _names(header, delimiter, width, source.names, path)
    data, numbers, broken = _parse(rows[start:], width, decimal, path.name)
    stamped = _timestamps(data, rows[start : start + 5])
    units |= {names[i]: "s" for i in stamped}
    return Table(
        name=str(path),
        columns={name: np.ascontiguousarray(data[:, i]) for i, name in enumerate(names)},
        lines=numbers,
        line_word="line",
        notes={"delimiter": delimiter, "decimal": decimal, "header_lines": rows[start][0] - 1},
        broken=broken,
        units=units,
        stamped=frozenset(names[i] for i in stamped),
    )


def _timestamps(data: Float64, sample: list[tuple[int, list[str]]]) -> list[int]:
    """Columns that hold instants, already seconds; times of day are made to go on after midnight."""
    found = []
    for i in range(data.shape[1]):
        cells = [row[i] for _, row in sample if i < len(row)]
        if any(not _NUMBER.match(c) and not math.isnan(seconds_of(c)) for c in cells):
            found.append(i)
            if np.nanmax(data[:, i], initial=0.0) <= DAY:
                data[:, i] = past_midnight(data[:, i])
    return found


def _decode(path: Path, encoding: str | None) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes of text are more than this program reads")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not raw.strip():
        raise InputError(f"{path}: the file is empty")
    guesses = (
        [encoding] if encoding else ["utf-16"] * raw.startswith((b"\xff\xfe", b"\xfe\xff")) + ["utf-8-sig"]
    )
    for guess in [*guesses, *([] if encoding else ["latin-1"])]:
        try:
            text = raw.decode(guess)
        except (UnicodeDecodeError, LookupError):
            continue
        if "\0" in text[:10_000]:
            break
        return text
    raise InputError(
        f"{path}: is no text that can be read as {encoding or 'UTF-8 or Latin-1'}; name its kind in the map"
    )


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


def _number(cell: str, comma: bool) -> float:
    """A number, or an instant as seconds; NaN where the cell holds neither."""
    try:
        return math.nan if "_" in cell else float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        pass
    if cell and cell[-1].isdigit() and ("D" in cell or "d" in cell) and _NUMBER.match(cell):
        # Fortran's double precision.
        return float(re.sub("[dD]", "e", cell).replace(",", "."))
    return seconds_of(cell)


def _is_value(cell: str) -> bool:
    return bool(_NUMBER.match(cell)) or not math.isnan(seconds_of(cell))


def _is_number(cell: str, decimal: str) -> bool:
    if not math.isnan(seconds_of(cell)):
        return True
    return bool(_NUMBER.match(cell)) and (decimal in ",." and not ("," in cell and decimal == "."))


def _find_delimiter(lines: list[str], decimal: str | None) -> str:
    """The separator that splits the body into the most columns of numbers, evenly."""
    body = lines[len(lines) // 2 :][:400]
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


def _find_decimal(lines: list[str], delimiter: str) -> str:
    body = lines[len(lines) // 2 :][:400]
    commas = sum("," in c and bool(_NUMBER.match(c)) for line in body for c in _cells(line, delimiter))
    points = sum("." in c and bool(_NUMBER.match(c)) for line in body for c in _cells(line, delimiter))
    return "," if commas > points else "."


def _first_data_row(rows: list[tuple[int, list[str]]], width: int, decimal: str, path: Path) -> int:
    for i, (_, cells) in enumerate(rows):
        if (
            len(cells) == width
            and all(_is_number(c, decimal) or c.lower() in _NOT_A_NUMBER for c in cells)
            and any(_is_number(c, decimal) for c in cells)
        ):
            # Rows above it that are half numbers are broken rows of data, not header.
            while i > 0 and len(rows[i - 1][1]) == width and _half_numbers(rows[i - 1][1], decimal):
                i -= 1
            return i
    raise InputError(
        f"{path}: no row of numbers found; give 'delimiter', 'decimal' and 'header_lines' in the map's "
        f"'source'"
    )


def _half_numbers(cells: list[str], decimal: str) -> bool:
    return 2 * sum(_is_number(c, decimal) for c in cells) >= len(cells)


def _names(
    header: list[str], delimiter: str, width: int, given: list[str] | None, path: Path
) -> tuple[list[str], dict[str, str]]:
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
        if len(cells) == width and any(c and not _NUMBER.match(c) for c in cells):
            candidates.append(cells)
    units: list[str] = []
    if len(candidates) >= 2 and _all_units(candidates[-1]):
        units = candidates.pop()
    names = candidates[-1] if candidates else [""] * width
    names = [
        n
        or (
            "time"
            if i == 0 and not (units and normal_unit(units[0]) not in FACTORS["time"])
            else f"column{i}"
        )
        for i, n in enumerate(names)
    ]
    unique: list[str] = []
    for n in names:
        unique.append(n if n not in unique else f"{n}.{sum(u.split('.')[0] == n for u in unique)}")
    return unique, dict(zip(unique, [u.strip("[]()") for u in units], strict=True)) if units else {}


def _all_units(cells: list[str]) -> bool:
    known = {u for table in FACTORS.values() for u in table} | {*BY_MACHINE, "-", ""}
    return all(normal_unit(c.strip("[]()")) in known for c in cells)


def _parse(
    rows: list[tuple[int, list[str]]], width: int, decimal: str, name: str
) -> tuple[Float64, np.typing.NDArray[np.int64], tuple[BrokenRow, ...]]:
    """(n, width) numbers; NaN where a cell holds none. Rows of another width are broken at once."""
    kept: list[list[float]] = []
    numbers: list[int] = []
    broken: list[BrokenRow] = []
    comma = decimal == ","
    for number, cells in rows:
        if len(cells) != width:
            # A missing last cell was taken for a separator at the end of the line.
            if len(cells) == width - 1:
                cells = [*cells, ""]
            else:
                broken.append(BrokenRow(name, number, f"{len(cells)} cells instead of {width}"))
                cells = [""] * width
        kept.append([_number(cell, comma) for cell in cells])
        numbers.append(number)
    data = np.array(kept, dtype=np.float64).reshape(len(kept), width)
    return data, np.array(numbers, dtype=np.int64), tuple(broken)


_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(:(?P<s>\d{2})([.,](?P<f>\d{1,9}))?)?"
_DATE = (
    r"((?P<Y>\d{4})[-/.](?P<M>\d{1,2})[-/.](?P<D>\d{1,2})"
    r"|(?P<d1>\d{1,2})(?P<sep>[./])(?P<d2>\d{1,2})[./](?P<Y2>\d{4}))"
)
_ZONE = r"\s*(?P<z>Z|UTC|[+-]\d{2}:?\d{2})?"
_INSTANT = re.compile(rf"({_DATE}[T ]\s*)?{_CLOCK}{_ZONE}$|{_DATE.replace('?P<', '?P<o')}$")
DAY = 86400.0


def seconds_of(cell: str) -> float:
    """Seconds since 1970 of a date with time (or a date alone), since midnight of a time of day; NaN else.

    An instant without zone counts as UTC: only differences matter. 1.2.2026 is the first of February,
    1/2/2026 the second of January.
    """
    if ":" not in cell and cell.count(".") + cell.count("/") + cell.count("-") < 2:
        return math.nan
    found = _INSTANT.match(cell)
    if found is None:
        return math.nan
    part = found.groupdict()
    prefix = "o" if part["oY"] or part["oY2"] else ""
    clock = int(part["h"] or 0) * 3600.0 + int(part["m"] or 0) * 60.0 + int(part["s"] or 0)
    clock += float(f"0.{part['f']}") if part["f"] else 0.0
    if not (part[prefix + "Y"] or part[prefix + "Y2"]):
        return clock
    if part[prefix + "Y"]:
        year, month, day = (int(part[prefix + k]) for k in "YMD")
    else:
        first, second = int(part[prefix + "d1"]), int(part[prefix + "d2"])
        year = int(part[prefix + "Y2"])
        month, day = (first, second) if part[prefix + "sep"] == "/" and first <= 12 else (second, first)
    try:
        midnight = datetime(year, month, day, tzinfo=UTC).timestamp()
    except ValueError:
        return math.nan
    return midnight + clock - _zone(part["z"])


def _zone(text: str | None) -> float:
    if text is None or text in ("Z", "UTC"):
        return 0.0
    digits = text[1:].replace(":", "")
    return (-1.0 if text[0] == "-" else 1.0) * (int(digits[:2]) * 3600.0 + int(digits[2:]) * 60.0)


def past_midnight(seconds: Float64) -> Float64:
    """Times of day that go on after midnight instead of starting over."""
    known = np.isfinite(seconds)
    turned = np.diff(seconds[known], prepend=seconds[known][:1]) < -0.5 * DAY
    out = seconds.copy()
    out[known] += DAY * np.cumsum(turned)
    return out
