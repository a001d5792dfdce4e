"""Tables from LabVIEW's measurement files (LVM): text with a header of its own."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.file_kind import FileKind
from invid.recording.readers.text_table import read_text, table_of_lines
from invid.recording.tables import Table, each_once
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
        names = [n if names.index(n) == i else f"{n}.{i}" for i, n in enumerate(names)]
        start = ends[1] + 2
        stop = next((i for i in range(start, len(lines)) if not lines[i].strip()), len(lines))
        rows = [separator.join(line.split(separator)[: len(names)]) for line in lines[start:stop]]
        known = {"delimiter": separator, "decimal": form.decimal, "header_lines": 0, "names": names}
        table = table_of_lines(path, rows, source.model_copy(update=known))

        def of(key: str, channel: int) -> str:
            """What a line of the segment's header says of a channel."""
            cells = segment.get(key, [])
            return cells[channel].strip() if channel < len(cells) else ""

        clocks, units, clock, columns = dict[str, str](), dict[str, str](), "", dict(table.columns)
        is_time = of("X_Dimension", 0).lower() in ("", "time")
        channels = [n for n in names if not n.startswith("X_Value")]
        for name in names:
            if name not in channels:
                clock = name
                units |= {name: "s"} if is_time else {}
                continue
            unit = of("Y_Unit_Label", channels.index(name))
            units |= {name: unit} if unit else {}
            clocks |= {name: clock} if clock and said.get("X_Columns", [""])[0].strip() == "Multi" else {}
        step = form.number(of("Delta_X", 0))
        if not clock and is_time and step > 0:
            columns["X_Value"] = frozen_float(step * np.arange(len(rows)))
            units["X_Value"] = "s"
        return replace(
            table, columns=columns, lines=None if table.lines is None else table.lines + start,
            broken=tuple(replace(b, line=b.line + start) for b in table.broken), units=units, notes={},
            clocks=each_once(clocks, columns), reasons=("the file is LVM of LabVIEW",), stamped=frozenset(),
            remarks=(f"the file holds {len(ends) - 1} segments: the first is read",) if ends[2:] else (),
        )  # fmt: skip


def _keys(lines: list[str], separator: str | None) -> dict[str, list[str]]:
    """Header lines: key → cells after it."""
    rows = [
        re.split(r"[\t,;]", line, maxsplit=1) if separator is None else line.split(separator)
        for line in lines
    ]
    return {r[0].strip(): [c.rstrip("\t") for c in r[1:]] for r in rows if r[0].strip()}
