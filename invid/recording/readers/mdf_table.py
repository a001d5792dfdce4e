"""Tables from MDF 4 (ASAM measurement data: CANape, INCA, Vector and CSS loggers), through asammdf.

asammdf reads in C. A damaged file makes it print, and one in a few hundred corrupts memory ("malloc():
invalid size"), so it works in a process of its own, where nothing else can be lost.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.processes import Helper, ProcessEnded
from invid.recording.import_map import Source
from invid.recording.readers.arrays import Columns
from invid.recording.readers.kinds import first_line, kind_named, limit_numbers
from invid.recording.tables import Table

TIME_LIMIT = 600.0
"""Seconds; a gigabyte takes one or two minutes."""


def read_mdf(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an MDF file, a clock for each channel group, values as the file converts them; or a CAN
    log."""
    if find_spec("asammdf") is None:
        raise ModuleNotFoundError("asammdf", name="asammdf")
    helper = Helper()
    try:
        found = helper.call(_columns, path.resolve(), timeout=TIME_LIMIT)
    except TimeoutError:
        raise InputError(f"{path}: reading it as MDF took more than {TIME_LIMIT:.0f} s") from None
    except ProcessEnded:
        found = "asammdf broke off on it; it is damaged"
    finally:
        helper.close()
    if isinstance(found, str):
        raise InputError(f"{path}: cannot be read as MDF: {found}", code="unreadable")
    if source.kind != "mdf" and any(n.startswith("CAN_DataFrame") for n in found.values):
        return kind_named("can_log")(path, source, beside=beside)
    table: Table = found.table(path, reasons=("the file is ASAM MDF",))
    return table


def _columns(path: Path) -> Columns | str:
    """The columns of a file; what is damaged of it, where it has none."""
    found = Columns()
    try:
        # Only here: the reader above waits for a process that has it.
        with import_module("asammdf").MDF(path) as file:
            groups: list[Any] = list(file.groups)
            claimed = {str(i): g.channel_group.cycles_nr * len(g.channels) for i, g in enumerate(groups)}
            limit_numbers(claimed, path)
            for index, group in enumerate(groups):
                clock = f"time of group {index}" if "time" in found.values else "time"
                # Kinds 2 and 3 are the master itself. One look for a group reads its blocks once.
                asked = [k for k, c in enumerate(group.channels) if c.channel_type not in (2, 3)]
                places = [(None, index, k) for k in asked]
                signals = file.select(places, validate=True, copy_master=False) if asked else []
                for number, signal in zip(asked, signals, strict=True):
                    values, instants = np.asarray(signal.samples), np.asarray(signal.timestamps, dtype=float)
                    if values.dtype.kind in "iufb" and values.ndim == 1 and 2 <= values.size == instants.size:
                        name = group.channels[number].name
                        twice = f".{index}.{number}" if name in found.values else ""
                        # Of a channel samples that are marked invalid are missing, and their instants.
                        alike = np.array_equal(found.values.get(clock, instants), instants)
                        own = clock if alike else f"time of {name}{twice}"
                        if own not in found.values:
                            found.add(own, instants, "s")
                        found.add(name + twice, values, signal.unit or "", own)
    except Exception as error:  # by kind of damage: MdfException, struct.error, ValueError, …
        return first_line(error)
    return found
