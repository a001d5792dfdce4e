"""Tables from TDMS (LabVIEW, DIAdem, FlexLogger), through npTDMS."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import nptdms.log
import numpy as np

from invid.recording.import_map import Source
from invid.recording.readers.arrays import Columns
from invid.recording.readers.kinds import limit_numbers
from invid.recording.tables import BrokenRow, Table

# What it would print of a file that was cut off is said of the file here.
nptdms.log.log_manager.set_level(logging.CRITICAL)


def read_tdms(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a TDMS file: a clock for each waveform's start and step, dates as seconds since 1970."""
    with nptdms.TdmsFile.open(path) as file:
        channels = [c for group in file.groups() for c in group.channels()]
        limit_numbers({f"{c.group_name}/{c.name}": len(c) for c in channels}, path)
        table = _columns(channels).table(path, reasons=("the file is TDMS",))
        if not file.file_status.incomplete_final_segment:
            return table
    last = max(c.size for c in table.columns.values())
    return replace(table, broken=(BrokenRow(path.name, last, "the file ends within its last segment"),))


def _columns(channels: list[Any]) -> Columns:
    found, known = Columns(), dict[tuple[float, float, int], str]()
    names = [c.name for c in channels]
    for channel in channels:
        stated, values = channel.properties, np.asarray(channel[:])
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        unit = stated.get("unit_string") or stated.get("NI_UnitDescription") or ""
        step, start = (float(stated.get(f"wf_{n}", 0.0)) for n in ("increment", "start_offset"))
        if values.ndim == 1 and found.add(name, values, str(unit)) and step > 0:
            clock = "time" if not known else f"time of {name}"
            clock = f"waveform {clock}" if clock in names else clock
            clock = known.setdefault((start, step, values.size), clock)
            found.add(clock, start + step * np.arange(values.size), "s")
            found.clocks[name] = clock
    return found
