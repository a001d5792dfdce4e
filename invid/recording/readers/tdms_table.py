"""Tables from TDMS (LabVIEW, DIAdem, FlexLogger), through npTDMS."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import nptdms.log
import numpy as np

from invid.numerics.arrays import Float64, frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.arrays import table_of
from invid.recording.readers.kinds import limit_numbers
from invid.recording.tables import BrokenRow, Table

# What it would print of a file that was cut off is said of the file here.
nptdms.log.log_manager.set_level(logging.CRITICAL)


def read_tdms(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a TDMS file: a clock for each waveform's start and step, dates as seconds since 1970."""
    with nptdms.TdmsFile.open(path) as file:
        channels = [c for group in file.groups() for c in group.channels()]
        limit_numbers({f"{c.group_name}/{c.name}": len(c) for c in channels}, path)
        table = _table(path, channels)
        if not file.file_status.incomplete_final_segment:
            return table
    last = max(c.size for c in table.columns.values())
    return replace(table, broken=(BrokenRow(path.name, last, "the file ends within its last segment"),))


def _table(path: Path, channels: list[Any]) -> Table:
    columns: dict[str, Float64] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    stamped: set[str] = set()
    known: dict[tuple[float, float, int], str] = {}
    names = [c.name for c in channels]
    for channel in channels:
        values = np.asarray(channel[:])
        if values.ndim != 1 or values.size < 2 or values.dtype.kind not in "iufbM":
            continue  # text, complex numbers, single values
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        if values.dtype.kind == "M":
            stamped.add(name)
            values = (values - np.datetime64(0, "s")) / np.timedelta64(1, "s")
        columns[name] = frozen_float(values)
        unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
        units |= {name: "s"} if name in stamped else {name: str(unit)} if unit else {}
        step = float(channel.properties.get("wf_increment", 0.0))
        if step > 0:
            start = float(channel.properties.get("wf_start_offset", 0.0))
            clock = "time" if not known else f"time of {name}"
            clock = known.setdefault(
                (start, step, values.size), f"waveform {clock}" if clock in names else clock
            )
            columns.setdefault(clock, frozen_float(start + step * np.arange(values.size)))
            units[clock] = "s"
            clocks[name] = clock
    return replace(
        table_of(path, columns, units, frozenset(stamped)), clocks=clocks, reasons=("the file is TDMS",)
    )
