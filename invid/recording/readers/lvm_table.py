"""Tables from LabVIEW's measurement files (LVM): text with a header of its own."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.file_kind import FileKind
from invid.recording.readers.text_table import read_text
from invid.recording.tables import BrokenRow, Table, each_once
from invid.recording.text_format import NumberFormat

_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}
_END = "***End_of_Header***"


class LvmFile(FileKind):
    """``LabVIEW Measurement``: a header of the file, one of the segment, names, rows."""

    name = "lvm"
    # LabVIEW Measurement<tab>
    header = re.compile(r"\ALabVIEW Measurement")

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns of the first segment, by its channels' names; X is time where the file says so."""
        lines = read_text(path, source.encoding)[0].splitlines()
        ends = [i for i, line in enumerate(lines) if line.startswith(_END)]
        if len(ends) < 2:
            raise InputError(
                f"{path}: is LVM without a segment ({_END!r} comes {len(ends)} times); is it whole?"
            )
        said = _keys(lines[: ends[0]], None)
        separator = _SEPARATORS.get((said.get("Separator") or ["Tab"])[0].lower(), "\t")
        form = NumberFormat((said.get("Decimal_Separator") or ["."])[0].strip() or ".")
        segment = _keys(lines[ends[0] + 1 : ends[1]], separator)
        names = [n.strip() for n in lines[ends[1] + 1].split(separator)]
        names = names[: -1 if names[-1] in ("Comment", "") else None]
        start = ends[1] + 2
        stop = next((i for i in range(start, len(lines)) if not lines[i].strip()), len(lines))
        if len(ends) > 2:
            stop = min(stop, ends[2])
        rows = np.full((stop - start, len(names)), np.nan)
        broken = []
        for k, line in enumerate(lines[start:stop]):
            cells = [form.number(c.strip()) for c in line.split(separator)[: len(names)]]
            rows[k, : len(cells)] = cells
            if len(cells) < len(names):
                broken.append(BrokenRow(path.name, start + k + 1, f"{len(cells)} cells of {len(names)}"))
        return _table(path, _Segment(names, rows, start, said, segment, form), broken, len(ends) - 1)


class _Segment:
    """Rows with their names, and what both headers say."""

    def __init__(
        self, names: list[str], rows: np.ndarray, start: int, said: dict[str, list[str]],
        segment: dict[str, list[str]], form: NumberFormat,
    ) -> None:  # fmt: skip
        self.names, self.rows, self.start, self.form = names, rows, start, form
        self.x = (said.get("X_Columns") or ["One"])[0].strip().lower()
        self.segment = segment

    def of(self, key: str, channel: int) -> str:
        """What a line of the segment's header says of a channel."""
        cells = self.segment.get(key, [])
        return cells[channel].strip() if channel < len(cells) else ""


def _table(path: Path, s: _Segment, broken: list[BrokenRow], segments: int) -> Table:
    columns, units, clocks = dict[str, np.ndarray](), dict[str, str](), dict[str, str]()
    names = [n if s.names.index(n) == i else f"{n}.{i}" for i, n in enumerate(s.names)]
    is_time = s.of("X_Dimension", 0).lower() in ("", "time")
    clock, channel = "", 0
    for i, name in enumerate(names):
        columns[name] = frozen_float(s.rows[:, i])
        if s.names[i].startswith("X_Value"):
            clock = name
            units |= {name: "s"} if is_time else {}
            continue
        unit = s.of("Y_Unit_Label", channel)
        units |= {name: unit} if unit else {}
        clocks |= {name: clock} if clock and s.x == "multi" else {}
        channel += 1
    step = s.form.number(s.of("Delta_X", 0))
    if not clock and is_time and not math.isnan(step) and step > 0:
        columns["X_Value"] = frozen_float(step * np.arange(s.rows.shape[0]))
        units["X_Value"] = "s"
    more = (f"the file holds {segments} segments: the first is read",) if segments > 1 else ()
    return Table(
        str(path), columns, lines=s.start + 1 + np.arange(s.rows.shape[0], dtype=np.int64), line_word="line",
        broken=tuple(broken), units=units, clocks=each_once(clocks, columns),
        reasons=("the file is LVM of LabVIEW",), remarks=more,
    )  # fmt: skip


def _keys(lines: list[str], separator: str | None) -> dict[str, list[str]]:
    """Header lines: key → cells after it."""
    rows = [
        re.split(r"[\t,;]", line, maxsplit=1) if separator is None else line.split(separator)
        for line in lines
    ]
    return {r[0].strip(): [c.rstrip("\t") for c in r[1:]] for r in rows if r[0].strip()}
