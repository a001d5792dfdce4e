"""Tables from what a serial monitor stamped: Arduino's, PlatformIO's, and terminals alike."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from invid.numerics.arrays import frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.file_kind import FileKind
from invid.recording.readers.text_table import read_text, seconds_of, table_of_lines
from invid.recording.tables import Table

_RECEIVED = "received"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LABELLED = rf"\s*(?:[A-Za-z]\w*\s*[:=]\s*{_NUMBER}[,;\t ]+)+[A-Za-z]\w*\s*[:=]\s*{_NUMBER}\s*$"
_PAIR = re.compile(rf"([A-Za-z]\w*)\s*[:=]\s*({_NUMBER}|nan)")


class SerialMonitorFile(FileKind):
    """Lines with the time of day at which a monitor received them before their own text."""

    name = "serial_monitor"
    # 12:36:19.016 -> 1000<tab>0.00046<tab>1.650
    # 12:36:19.016 > 1000,0.00046,1.650
    # [12:36:19.016] 1000,0.00046,1.650
    # [2026-02-03 12:36:19.016] 1000 0.00046 1.650
    line = re.compile(
        r"(?P<open>\[)?(?P<at>(?:\d{4}-\d\d-\d\d[ T])?\d\d:\d\d:\d\d[.,:]\d{1,6})(?(open)\]\s*[:>]?| -?>) ?"
        r"(?P<text>.*)$"
    )
    header = re.compile(rf"\A(?:[^\n]*\n){{0,3}}{line.pattern}", re.MULTILINE)

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns of the lines without their stamps, and the stamps as ``received``."""
        text, encoding = read_text(path, source.encoding)
        lines = text.splitlines()
        found = [self.line.match(line) for line in lines]
        own = [m["text"] if m else line for m, line in zip(found, lines, strict=True)]
        own, source = without_labels(own, source)
        table = table_of_lines(path, own, source, encoding)
        at = [] if table.lines is None else [found[i - 1] for i in table.lines.tolist()]
        stamps = frozen_float(np.array([seconds_of(m["at"]) if m else np.nan for m in at]))
        return replace(
            table,
            columns={**table.columns, _RECEIVED: stamps},
            stamped=table.stamped | {_RECEIVED},
            units={**table.units, _RECEIVED: "s"},
            notes={},
            reasons=(*table.reasons, "a serial monitor stamped the lines: 'received'"),
        )


class LabelledFile(FileKind):
    """Lines that name each of their values, as Arduino's plotter and Teleplot take them."""

    name = "labelled lines"
    # t_us:1000,pos:0.00046,torque:1.650
    # t: 0.001 pos: 0.00046 torque: 1.650
    header = re.compile(rf"^{_LABELLED}", re.MULTILINE)

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns by the labels."""
        text, encoding = read_text(path, source.encoding)
        lines, source = without_labels(text.splitlines(), source)
        table = table_of_lines(path, lines, source, encoding)
        return replace(table, notes={}, reasons=(*table.reasons, "each value has its label in its line"))


def without_labels(lines: list[str], source: Source) -> tuple[list[str], Source]:
    """Lines of labelled values as rows of a table, with the labels as its names; other lines as they are."""
    first = next((line for line in lines[:50] if re.match(_LABELLED, line)), None)
    if first is None:
        return lines, source
    names = [n for n, _ in _PAIR.findall(first)]
    rows = []
    for line in lines:
        found = dict(_PAIR.findall(line))
        rows.append(";".join(found.get(n, "nan") for n in names) if found else line)
    return rows, source.model_copy(update={"names": source.names or names, "delimiter": ";"})
