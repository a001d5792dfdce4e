"""Reads one MDF file in a process of its own: ``python -m invid.recording.readers.mdf_process FILE OUT.npz``.

asammdf reads in C. A damaged file makes it print, and one in a few hundred corrupts memory ("malloc():
invalid size"), so it works where nothing else can be lost.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

MAX_VALUES = 200_000_000


def main(source: Path, out: Path) -> None:
    """Writes arrays ``0``, ``1``, … and ``about``: JSON with their names, clocks and units, or an error."""
    import asammdf  # noqa: PLC0415 (an extra: not everybody has it)

    arrays: list[np.typing.NDArray[np.float64]] = []
    about: dict[str, Any] = {"names": [], "clocks": {}, "units": {}, "error": ""}
    try:
        with asammdf.MDF(source) as file:
            claimed = sum(g.channel_group.cycles_nr * len(g.channels) for g in file.groups)
            if claimed > MAX_VALUES:
                raise ValueError(f"{claimed} numbers, more than this program reads from one file")
            for index, _ in enumerate(file.groups):
                _take(file, index, arrays, about)
    except Exception as error:  # by kind of damage: MdfException, struct.error, ValueError, …
        about["error"] = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
    numbered = {str(i): a for i, a in enumerate(arrays)}
    np.savez(out, about=np.array(json.dumps(about)), **numbered)  # type: ignore[arg-type]


def _take(file: Any, index: int, arrays: list[np.typing.NDArray[np.float64]], about: dict[str, Any]) -> None:
    names: list[str] = about["names"]
    clock = ""
    for number, channel in enumerate(file.groups[index].channels):
        if channel.channel_type in (2, 3):
            continue  # the master itself
        signal = file.get(group=index, index=number)
        values, instants = np.asarray(signal.samples), np.asarray(signal.timestamps, dtype=float)
        numbers = values.dtype.kind in "iufb" and values.ndim == 1 and values.size >= 2
        if not numbers or instants.size != values.size:
            continue  # text and arrays
        if not clock:
            clock = f"time of group {index}" if "time" in names else "time"
            names.append(clock)
            arrays.append(instants)
            about["units"][clock] = "s"
        name = channel.name if channel.name not in names else f"{channel.name}.{index}.{number}"
        names.append(name)
        arrays.append(values.astype(np.float64))
        about["clocks"][name] = clock
        if signal.unit:
            about["units"][name] = signal.unit


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
