"""Several files that are one record, each with its own clock: one table, its columns ``name:column``."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.clock import read_stamps
from invid.recording.import_map import JoinedSource, TimeMap
from invid.recording.readers.kinds import read_table
from invid.recording.tables import Table


def read_joined(
    files: Sequence[Path], sources: Sequence[JoinedSource], beside: Path | None
) -> dict[Path, Table]:
    """A table for each record, by its first file: the first file of every source, then the second, …

    Raises
    ------
    InputError
        A source without a file, or sources with different numbers of them.
    """
    found = {
        s.name: [f for f in files if fnmatch.fnmatchcase(f.as_posix(), f"*/{s.file}") or f.name == s.file]
        for s in sources
    }
    counts = {name: len(own) for name, own in found.items()}
    if len(set(counts.values())) != 1 or 0 in counts.values():
        shown = ", ".join(f"{n!r} {c}" for n, c in counts.items())
        raise InputError(
            f"map: 'sources' must match one file each for every record; found are {shown}",
            way_out="see 'file' in each of 'sources', and the files that SOURCE or 'files' names",
            code="files_unmatched",
            values=counts,
        )
    return {group[0]: _join(group, sources, beside) for group in zip(*found.values(), strict=True)}


def _join(group: Sequence[Path], sources: Sequence[JoinedSource], beside: Path | None) -> Table:
    columns: dict[str, Float64] = {}
    clocks, units, remarks = dict[str, str](), dict[str, str](), list[str]()
    aliases: dict[str, str | int] = {}
    for path, source in zip(group, sources, strict=True):
        table, clock = read_table(path, source, beside=beside), f"{source.name}:time"
        instants, said = _instants(table, source.time, path)
        own = {
            f"{source.name}:{n}": c
            for n, c in table.columns.items()
            if c.size == instants.size and n != "time"
        }
        columns |= {clock: frozen_float(instants + source.shift_s), **own}
        clocks |= dict.fromkeys(own, clock)
        units |= {clock: "s"} | {f"{source.name}:{n}": u for n, u in table.units.items() if n != "time"}
        aliases |= {f"{source.name}:{a}": f"{source.name}:{n}" for a, n in table.aliases.items()}
        remarks += [f"{source.name}: {r}" for r in (*table.remarks, *said)]
    ends = {
        c: (float(np.nanmin(columns[c])), float(np.nanmax(columns[c])))
        for c in dict.fromkeys(clocks.values())
    }
    if max(a for a, _ in ends.values()) >= min(b for _, b in ends.values()):
        shown = "; ".join(f"{n} from {a:.6f} to {b:.6f} s" for n, (a, b) in ends.items())
        raise InputError(
            f"{group[0]}: the clocks of 'sources' have no time in common: {shown}",
            way_out="where one counts from another start say so by its 'shift_s'",
            code="no_common_time",
            values={n: list(e) for n, e in ends.items()},
        )
    return Table(
        " + ".join(p.name for p in group),
        columns,
        units=units,
        clocks=clocks,
        aliases=aliases,
        remarks=tuple(remarks),
    )


def _instants(table: Table, said: TimeMap, path: Path) -> tuple[Float64, tuple[str, ...]]:
    """Instants [s] of a file's rows by its own clock, and what was done about them."""
    if said.column is None:
        size = max(c.size for c in table.columns.values())
        return np.arange(size) / (said.sample_rate_hz or 1.0), ()
    how = said.reading(f"{path}: time")
    stamps = read_stamps(table.column(said.column) * how.unit, how, str(path))
    return stamps.instants, stamps.remarks
