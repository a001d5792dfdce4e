"""Tables from TDMS (LabVIEW, DIAdem, FlexLogger), through npTDMS."""

from __future__ import annotations

import logging
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.tables import BrokenRow, Table

MAX_VALUES = 200_000_000


def read_tdms_table(path: Path) -> Table:
    """Columns of a TDMS file: a clock for each waveform's start and step, dates as seconds since 1970."""
    if find_spec("nptdms") is None:
        raise InputError(f"{path}: TDMS needs the package npTDMS; install it with pip install 'invid[tdms]'")
    import nptdms.log  # noqa: PLC0415 (an extra: not everybody has it)

    # What it would print of a file that was cut off is said of the file here.
    nptdms.log.log_manager.set_level(logging.CRITICAL)
    try:
        with nptdms.TdmsFile.open(path) as file:
            channels = [c for group in file.groups() for c in group.channels()]
            claimed = sum(len(c) for c in channels)
            if claimed > MAX_VALUES:
                raise InputError(f"{path}: {claimed} numbers, more than this program reads from one file")
            table = _table(path, channels)
            if not file.file_status.incomplete_final_segment:
                return table
            last = max(c.size for c in table.columns.values())
            cut = BrokenRow(path.name, last, "the file ends within its last segment")
            return replace(table, broken=(cut,))
    except InputError:
        raise
    except Exception as error:  # by kind of damage: ValueError, struct.error, KeyError, …
        said = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{path}: cannot be read as TDMS: {said}; is it whole?") from None


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
            key = (start, step, values.size)
            clock = known.setdefault(key, "time" if not known else f"time of {name}")
            clock = known[key] = f"waveform {clock}" if clock in names else clock
            columns.setdefault(clock, frozen_float(start + step * np.arange(values.size)))
            units[clock] = "s"
            clocks[name] = clock
    if not columns:
        raise InputError(f"{path}: holds no channel of real numbers with at least two samples")
    return Table(
        str(path), columns, units=units, stamped=frozenset(stamped), clocks=clocks,
        reasons=("the file is TDMS",),
    )  # fmt: skip
