"""Reads one MDF file in a process of its own: ``python -m invid.recording.readers.mdf_process FILE OUT``.

asammdf reads in C. A damaged file makes it print, and one in a few hundred corrupts memory ("malloc():
invalid size"), so it works where nothing else can be lost.
"""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np

MAX_VALUES = 200_000_000


def main(source: Path, out: Path) -> None:
    """Pickles ``columns`` by name with their ``clocks`` and ``units``, or the ``error``."""
    import asammdf  # noqa: PLC0415 (an extra: not everybody has it)

    found: dict[str, Any] = {"columns": {}, "clocks": {}, "units": {}, "error": ""}
    try:
        with asammdf.MDF(source) as file:
            claimed = sum(g.channel_group.cycles_nr * len(g.channels) for g in file.groups)
            if claimed > MAX_VALUES:
                raise ValueError(f"{claimed} numbers, more than this program reads from one file")
            for index, _ in enumerate(file.groups):
                _take(file, index, found)
    except Exception as error:  # by kind of damage: MdfException, struct.error, ValueError, …
        found["error"] = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
    with out.open("wb") as stream:
        pickle.dump(found, stream, protocol=5)


def _take(file: Any, index: int, found: dict[str, Any]) -> None:
    columns, clock = found["columns"], ""
    for number, channel in enumerate(file.groups[index].channels):
        if channel.channel_type in (2, 3):
            continue  # the master itself
        signal = file.get(group=index, index=number)
        values, instants = np.asarray(signal.samples), np.asarray(signal.timestamps, dtype=float)
        numbers = values.dtype.kind in "iufb" and values.ndim == 1 and values.size >= 2
        if not numbers or instants.size != values.size:
            continue  # text and arrays
        if not clock:
            clock = f"time of group {index}" if "time" in columns else "time"
            columns[clock], found["units"][clock] = instants, "s"
        name = channel.name if channel.name not in columns else f"{channel.name}.{index}.{number}"
        columns[name], found["clocks"][name] = values.astype(np.float64), clock
        if signal.unit:
            found["units"][name] = signal.unit


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
