"""Tables from delimited text: any separator and header, LabVIEW's LVM, TwinCAT Scope, serial monitors,
lists."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.text_dialect import (
    Dialect,
    find_delimiter,
    find_dialect,
    is_value,
    numbered_twice,
    split_cells,
)
from invid.recording.readers.text_rows import Text, read_rows
from invid.recording.tables import Table, each_once
from invid.recording.text_encoding import decode_text

MAX_BYTES = 2_000_000_000
_SAMPLE = 1 << 18
"""Bytes of the head, and of the middle, that the dialect is found by."""
_OF_JOINTS = re.compile(r"(^|[^a-z])(joint_?)?names?_?\d*$|^joint$")
_STAMP = re.compile(
    # 12:36:19.016 -> 1000<tab>0.00046        Arduino
    # 12:36:19.016 > 1000,0.00046             PlatformIO
    # [2026-02-03 12:36:19.016] 1000 0.00046  terminals
    r"(?P<open>\[)?(?P<at>(?:\d{4}-\d\d-\d\d[ T])?\d\d:\d\d:\d\d[.,:]\d{1,6})(?(open)\]\s*[:>]?| -?>) "
    r"?(?P<text>.*)$"
)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PAIR = re.compile(rf"([A-Za-z]\w*)\s*[:=]\s*({_NUMBER}|nan)")
# t_us:1000,pos:0.00046,torque:1.650
_LABELLED = re.compile(rf"\s*(?:{_PAIR.pattern}[,;\t ]+)+{_PAIR.pattern}\s*$")
# "[0.1, 0.2]", (0.1 0.2), {0.1;0.2}
_LIST = re.compile(rf"\"?[\[({{]\s*({_NUMBER}(?:[\s,;]+{_NUMBER})*)\s*[\])}}]\"?")
_LVM_END = "***End_of_Header***"
_SCOPE_MARK = "SampleTime[ms]"
_SCOPE_HEADER = 80
"""Lines that the channels' block of a scope export begins and ends within."""
_TICKS_FROM = 1e15
"""Milliseconds never reach this (30,000 years); ticks of 100 ns since 1601 passed it in 1604."""


def read_text(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a text file; what ``source`` leaves open is found out and noted."""
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{path}: {size} bytes of text are more than this program reads", code="too_large")
    with path.open("rb") as raw:
        head = raw.read(_SAMPLE)
        whole = size <= _SAMPLE or b"\0" in head or source.encoding is not None
        head += raw.read() if whole else b""
        if not whole:
            raw.seek(max(size // 2, _SAMPLE))
        middle = raw.read(_SAMPLE)
    if not head.strip():
        raise InputError(f"{path}: the file is empty", code="no_data")
    if not whole:
        head, middle = head.rpartition(b"\n")[0], middle.partition(b"\n")[2].rpartition(b"\n")[0]
    text, encoding = decode_text(head, source.encoding, str(path))
    tail, _ = decode_text(middle or b"\n", encoding, str(path))
    lines = text.splitlines()
    after = tail.splitlines() if middle else lines[len(lines) // 2 :][:2000]
    layout = next((make for sign, make in _LAYOUTS if sign.search(text)), None)
    rewrite = None if layout or source.kind == "csv" else _rewriting(lines, after)
    if layout is None and rewrite is None and encoding in ("utf-8", "utf-8-sig"):
        return _delimited(Text(path, None, '"' in text or '"' in tail), lines, after, source)
    lines = lines if whole else decode_text(path.read_bytes(), encoding, str(path))[0].splitlines()
    if layout is not None:
        return layout(path, lines, source)
    if rewrite is not None:
        lines, source = rewrite.apply(lines, source)
    table = _delimited(_rewritten(path, lines), lines, lines[len(lines) // 2 :][:2000], source)
    return replace(table, reasons=(*table.reasons, rewrite.note)) if rewrite else table


def _rewritten(path: Path, lines: Sequence[str]) -> Text:
    text = "\n".join(lines)
    return Text(path, text.encode(), '"' in text)


def _delimited(text: Text, head: Sequence[str], middle: Sequence[str], source: Source) -> Table:
    dialect = find_dialect(head, middle, source, str(text.path))
    if dialect.delimiter == " " and any(re.search(r"^\s|\s\s|\t", line) for line in (*head, *middle)):
        # polars knows no run of blanks.
        raw = text.path.read_bytes() if text.rewritten is None else text.rewritten
        text = replace(text, rewritten=re.sub(rb"(?m)^ | $", b"", re.sub(rb"[ \t\r]+", b" ", raw)))
    _refuse_one_joint_a_row(dialect, middle, text.path)
    said = {k: getattr(dialect, k) for k in ("delimiter", "decimal", "thousands") if getattr(dialect, k)}
    reasons = ", ".join(f"{k} {v!r}" for k, v in said.items())
    return replace(read_rows(text, dialect), reasons=(f"the file is delimited text: {reasons}",))


def _refuse_one_joint_a_row(dialect: Dialect, body: Sequence[str], path: Path) -> None:
    """InputError where a column names the joint of a row, and names several."""
    for i in (i for i, n in enumerate(dialect.names) if i in dialect.words and _OF_JOINTS.search(n.lower())):
        cells = [split_cells(line, dialect.delimiter) for line in body]
        said = Counter(c[i] for c in cells if len(c) == len(dialect.names) and c[i] and not is_value(c[i]))
        if len(said) > 1:
            name = dialect.names[i]
            raise InputError(
                f"{path}: {name!r} changes from row to row ({', '.join(sorted(said)[:4])}): the numbers "
                "beside "
                "it are of several joints in one column",
                way_out="write a table with a column a joint (pandas: "
                f"df.pivot(index=…, columns={name!r}), each time once), or give the MCAP",
                code="one_joint_a_row",
            )


@dataclass(frozen=True)
class _Rewriting:
    """Lines as a table has them."""

    note: str
    apply: Callable[[list[str], Source], tuple[list[str], Source]]


def _rewriting(head: Sequence[str], middle: Sequence[str]) -> _Rewriting | None:
    """What must be done to lines before they are a table: what most of them look like decides."""
    sample = [line for line in (*head[:20], *middle[:100]) if line.strip()]
    for pattern, rewriting in _REWRITINGS:
        if 2 * sum(bool(pattern(line)) for line in sample) > len(sample):
            return rewriting
    return None


def _without_stamps(lines: list[str], source: Source) -> tuple[list[str], Source]:
    found = [_STAMP.match(line) for line in lines]
    own = [m["text"] if m else line for m, line in zip(found, lines, strict=True)]
    if (inner := _rewriting(own, own)) is not None:
        own, source = inner.apply(own, source)
    delimiter = source.delimiter or find_delimiter([line for line in own[len(own) // 2 :] if line.strip()])
    at = [m["at"].replace(" ", "T") if m else "" for m in [None] * (len(own) - len(found)) + found]
    # A line of names was stamped as well, or made of the labels.
    at = ["received" if re.match(r"\s*[A-Za-z#]", line) else a for a, line in zip(at, own, strict=True)]
    rows = [f"{line.rstrip()}{delimiter}{a}" if line.strip() else "" for a, line in zip(at, own, strict=True)]
    return rows, source.model_copy(update={"delimiter": delimiter})


def _without_labels(lines: list[str], source: Source) -> tuple[list[str], Source]:
    names = [n for n, _ in _PAIR.findall(next(line for line in lines if _LABELLED.match(line)))]
    rows = ["\t".join(names)]
    for line in lines:
        found = dict(_PAIR.findall(line))
        rows.append("\t".join(found.get(n, "nan") for n in names) if found else line)
    return rows, source.model_copy(update={"delimiter": "\t"})


def _without_brackets(lines: list[str], source: Source) -> tuple[list[str], Source]:
    """Lines with a cell an entry where cells hold lists, each named by its place."""
    sample = [line for line in lines if _LIST.search(line)][:200]
    delimiter = source.delimiter or find_delimiter([_LIST.sub("1", line) for line in sample])
    first = lines.index(sample[0])
    sizes = [len(m[1].replace(",", " ").replace(";", " ").split()) for m in _LIST.finditer(sample[0])]
    lists = iter(sizes)
    cells = split_cells(_LIST.sub("\0", sample[0]), delimiter)
    wide = [next(lists) if "\0" in cell else 0 for cell in cells]
    above = [split_cells(line.lstrip("#%"), delimiter) for line in lines[:first]]
    names = next((a for a in reversed(above) if len(a) == len(cells)), [])
    names = names or [f"list{sum(map(bool, wide[:i]))}" if w else "" for i, w in enumerate(wide)]
    header = [f"{n}[{i}]" if w else n for n, w in zip(names, wide, strict=True) for i in range(max(w, 1))]
    rows = ["\t".join(header)]
    for line in lines[first:]:
        entries = ["\t".join(m[1].replace(",", " ").replace(";", " ").split()) for m in _LIST.finditer(line)]
        parts = iter(entries)
        rows.append(
            "\t".join(next(parts) if "\0" in c else c for c in split_cells(_LIST.sub("\0", line), delimiter))
        )
    return rows, source.model_copy(update={"delimiter": "\t"})


_REWRITINGS = (
    (_STAMP.match, _Rewriting("a serial monitor stamped the lines: 'received'", _without_stamps)),
    (_LABELLED.match, _Rewriting("each value has its label in its line", _without_labels)),
    (_LIST.search, _Rewriting("lists in brackets are a column an entry", _without_brackets)),
)


def _keys(lines: Sequence[str], separator: str) -> dict[str, list[str]]:
    """Lines of a header: first cell → cells after it."""
    rows = [[c.strip().strip('"') for c in line.split(separator)] for line in lines]
    return {r[0]: r[1:] for r in rows if r[0]}


def _read_lvm(path: Path, lines: Sequence[str], source: Source) -> Table:
    """The first segment of LabVIEW's measurement file, by its channels' names; X is time where it says so."""
    ends = [i for i, line in enumerate(lines) if line.startswith(_LVM_END)]
    if len(ends) < 2:
        raise InputError(
            f"{path}: is LVM without a segment ({_LVM_END!r} comes {len(ends)} times); is it whole?"
        )
    plain = {
        k: v
        for line in lines[: ends[0]]
        for k, _, v in [re.sub(r"[\t,;]", "\0", line, count=1).partition("\0")]
    }
    separator = {"comma": ",", "semicolon": ";"}.get(plain.get("Separator", "").strip().lower(), "\t")
    segment = _keys(lines[ends[0] + 1 : ends[1]], separator)
    names = numbered_twice(
        n.strip() for n in lines[ends[1] + 1].split(separator) if n.strip() not in ("Comment", "")
    )
    start = ends[1] + 2
    stop = next((i for i in range(start, len(lines)) if not lines[i].strip()), len(lines))
    rows = [separator.join(line.split(separator)[: len(names)]) for line in lines[start:stop]]
    is_time = (segment.get("X_Dimension") or ["Time"])[0].lower() in ("", "time")
    decimal = plain.get("Decimal_Separator", ".").strip()[:1] or "."
    table = read_rows(_rewritten(path, rows), Dialect(separator, decimal, None, 0, names))
    clocks, units, clock = dict[str, str](), dict[str, str](), ""
    channels = [n for n in names if not n.startswith("X_Value")]
    labels = dict(zip(channels, segment.get("Y_Unit_Label", []), strict=False))
    for name in names:
        if name not in channels:
            clock = name
            continue
        clocks |= {name: clock} if clock and plain.get("X_Columns", "").strip() == "Multi" else {}
        units |= {name: labels[name]} if labels.get(name) else {}
    columns = dict(table.columns)
    step = float((segment.get("Delta_X") or ["0"])[0].replace(decimal, ".") or 0.0)
    if is_time and step > 0 and not np.isfinite(columns.get("X_Value", np.full(1, np.nan))).any():
        columns["X_Value"] = frozen_float(step * np.arange(len(rows)))
    units |= {n: "s" for n in columns if n.startswith("X_Value") and is_time}
    return replace(
        table, columns=columns, units=units, clocks=each_once(clocks, columns), notes={},
        lines=None if table.lines is None else table.lines + start, reasons=("the file is LVM of LabVIEW",),
        broken=tuple(replace(b, line=b.line + start) for b in table.broken),
        remarks=(f"the file holds {len(ends) - 1} segments: the first is read",) if ends[2:] else (),
    )  # fmt: skip


def _read_scope(path: Path, lines: Sequence[str], source: Source) -> Table:
    """A text export of TwinCAT Scope: a block of header lines a channel, a time column for some channels
    each.

    The layout is that of the exports in the tests of pytcs (github.com/CagtayFabry/pytcs, TwinCAT 3 Scope
    3.4): a cell of the header that repeats its line's word heads a time column, the cells after it
    its channels.
    """
    mark = next(i for i, line in enumerate(lines) if line.lstrip('" ').startswith(_SCOPE_MARK))
    delimiter = lines[mark].lstrip('" ')[len(_SCOPE_MARK) :].lstrip('"')[:1] or "\t"
    named = [i for i in range(mark) if lines[i].lstrip('" ').startswith("Name") and delimiter in lines[i]]
    if not named:
        raise InputError(
            f"{path}: a scope export without a line 'Name' above {_SCOPE_MARK!r}; export it again"
        )
    block = lines[named[-1] : named[-1] + _SCOPE_HEADER]
    first = next((i for i in range(mark, len(lines)) if not lines[i].strip()), mark) + 1
    heads = [c.strip().strip('"') for c in block[0].rstrip(delimiter).split(delimiter)]
    rows = [line.rstrip() for line in lines[first:]]
    if rows and len(rows[0].rstrip(delimiter).split(delimiter)) != len(heads):
        raise InputError(
            f"{path}: the scope export names {len(heads)} columns, its first row of numbers has others",
            way_out=f"where a name holds the separator {delimiter!r}, export it with another separator",
        )
    names = [
        f"time of {heads[i + 1]}" if n == "Name" and i + 1 < len(heads) else n for i, n in enumerate(heads)
    ]
    names = ["time" if i == 0 else n for i, n in enumerate(names)]
    decimal = "," if delimiter != "," and any("," in row for row in rows[:400]) else "."
    table = read_rows(_rewritten(path, rows), Dialect(delimiter, decimal, None, 0, numbered_twice(names)))
    stated = {k: _keys(block, delimiter).get(k, []) for k in ("Unit", "ScaleFactor", "Unit ScaleFactor")}
    units, clocks, columns, clock, size = dict[str, str](), dict[str, str](), dict(table.columns), "", 0
    for i, name in enumerate(table.columns):
        if heads[i] == "Name":
            clock, values = name, columns[name]
            size = int(np.isfinite(values).sum())
            values = (values - values[0]) * 1e-4 if size and values[size - 1] > _TICKS_FROM else values
            columns[name], units[name] = frozen_float(values[:size]), "ms"
            continue
        clocks[name], columns[name] = clock, columns[name][:size]
        unit = (["", *stated["Unit"]][i : i + 1] or [""])[0].split(" (")[0]
        units |= {name: unit} if unit and not unit.startswith("(") else {}
    reasons = ["the file is a text export of TwinCAT Scope"]
    if any(
        f not in ("", "1", "ScaleFactor", "Unit ScaleFactor")
        for k in ("ScaleFactor", "Unit ScaleFactor")
        for f in stated[k]
    ):
        reasons.append(
            "a scale factor is stated; whether the numbers hold it already depends on 'Scale values before "
            "export': compare one with the scope"
        )
    return replace(
        table,
        columns=columns,
        lines=None,
        line_word="row",
        units=units,
        clocks=clocks,
        notes={},
        reasons=tuple(reasons),
    )


_LAYOUTS: tuple[tuple[re.Pattern[str], Callable[[Path, Sequence[str], Source], Table]], ...] = (
    (re.compile(r"\A\ufeff?LabVIEW Measurement"), _read_lvm),
    (re.compile(r'(?m)^[" ]*SampleTime\[ms\]'), _read_scope),
)
