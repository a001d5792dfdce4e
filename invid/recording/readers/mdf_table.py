"""Tables from MDF 4 (ASAM measurement data: CANape, INCA, Vector and CSS loggers), through asammdf.

asammdf reads in C. A damaged file makes it print, and one in a few hundred corrupts memory ("malloc():
invalid size"), so it works in a process of its own, where nothing else can be lost.
"""

from __future__ import annotations

import pickle
import tempfile
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.processes import Helper, ProcessEnded
from invid.recording.import_map import Source
from invid.recording.readers.arrays import table_of
from invid.recording.readers.kinds import first_line, kind_named, limit_numbers
from invid.recording.tables import Table

TIME_LIMIT = 600.0
"""Seconds; a gigabyte takes one or two minutes."""


def read_mdf(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an MDF file, a clock for each channel group, values as the file converts them; or a CAN
    log."""
    if find_spec("asammdf") is None:
        raise ModuleNotFoundError("asammdf", name="asammdf")
    with tempfile.TemporaryDirectory(prefix="invid-mdf-") as folder:
        out, helper = Path(folder) / "table", Helper()
        try:
            damage = helper.call(_write_table, path.resolve(), out, timeout=TIME_LIMIT)
            if damage is not None:
                raise InputError(f"{path}: cannot be read as MDF: {damage}", code="unreadable")
            with out.open("rb") as stream:
                found: Table = pickle.load(stream)
        except TimeoutError:
            raise InputError(f"{path}: reading it as MDF took more than {TIME_LIMIT:.0f} s") from None
        except (ProcessEnded, OSError):
            raise InputError(
                f"{path}: cannot be read as MDF: asammdf broke off on it; it is damaged", code="unreadable"
            ) from None
        finally:
            helper.close()
    if source.kind != "mdf" and any(n.startswith("CAN_DataFrame") for n in found.columns):
        return kind_named("can_log")(path, source, beside=beside)
    return Table(
        str(path), found.columns, units=found.units, clocks=found.clocks, reasons=("the file is ASAM MDF",)
    )


def _write_table(path: Path, out: Path) -> str | None:
    """Write the pickled table of a file; what is damaged of it, where it has none."""
    try:
        found = _table(path)
    except Exception as error:  # by kind of damage: MdfException, struct.error, ValueError, …
        return first_line(error)
    out.write_bytes(pickle.dumps(found, protocol=5))
    return None


def _table(path: Path) -> Table:
    columns: dict[str, Any] = {}
    clocks: dict[str, str] = {}
    units: dict[str, str] = {}
    # Only here: the reader above waits for a process that has it.
    with import_module("asammdf").MDF(path) as file:
        groups: list[Any] = list(file.groups)
        claimed = {str(i): g.channel_group.cycles_nr * len(g.channels) for i, g in enumerate(groups)}
        limit_numbers(claimed, path)
        for index, group in enumerate(groups):
            clock = f"time of group {index}" if "time" in columns else "time"
            for number, channel in enumerate(group.channels):
                if channel.channel_type in (2, 3):
                    continue  # the master itself
                signal = file.get(group=index, index=number)
                values, instants = np.asarray(signal.samples), np.asarray(signal.timestamps, dtype=float)
                numbers = values.dtype.kind in "iufb" and values.ndim == 1 and values.size >= 2
                if not numbers or instants.size != values.size:
                    continue  # text and arrays
                columns[clock], units[clock] = instants, "s"
                name = channel.name if channel.name not in columns else f"{channel.name}.{index}.{number}"
                columns[name], clocks[name] = values.astype(np.float64), clock
                units |= {name: signal.unit} if signal.unit else {}
    return Table(str(path), table_of(path, columns, {}).columns, units=units, clocks=clocks)
