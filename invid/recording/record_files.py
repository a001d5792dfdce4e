"""The files that an import reads: given, or named by a map; and several of them that are one record."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.import_map import ExperimentMap, ImportMap, JoinedSource
from invid.recording.readers.kinds import is_document, read_table
from invid.recording.record_rows import read_clock
from invid.recording.tables import Table


def _natural(path: Path) -> list[Any]:
    return [(int(p), "") if p.isdigit() else (-1, p) for p in re.split(r"(\d+)", str(path))]


def named_files(
    sources: Sequence[Path], chart: ImportMap, beside: Path | None
) -> tuple[list[Path], tuple[str, ...]]:
    """Files and folders to read: those given, else the map's ``files``; and a sentence for each left out.

    Where ``skip`` leaves files out, folders are written out as their files.
    """
    found = list(sources)
    for pattern in [] if sources else chart.files:
        root = beside or Path()
        matched = sorted(root.glob(pattern), key=_natural)
        if not matched:
            raise InputError(f"map: 'files': nothing matches {pattern!r} in {root}")
        found += matched
    if not found:
        raise InputError("no file is named: give SOURCE, or 'files' in the map (names or patterns beside it)")
    for source in found:
        if not source.exists():
            raise InputError(f"{source}: no such file or folder")
    documents = [p.name for s in found if s.is_dir() for p in documents_inside(s)]
    aside = (f"documents are left out: {', '.join(documents[:8])}",) if documents else ()
    if not chart.skip:
        return found, aside
    every = [f for s in found for f in (all_inside(s) if s.is_dir() else [s])]
    reasons = {f: r for p, r in chart.skip.items() for f in every if _matches(f.as_posix(), p)}
    unused = [p for p in chart.skip if not any(_matches(f.as_posix(), p) for f in every)]
    if unused:
        raise InputError(f"map: 'skip' names {unused[0]!r}, and no file is called so")
    return [f for f in every if f not in reasons and (f in found or not is_document(f))], (
        *aside,
        *(f"{f.name} is left out: {reason}" for f, reason in reasons.items()),
    )


def files_inside(folder: Path) -> list[Path]:
    """Every file below a folder but documents and programs, numbers in names in their order."""
    return [p for p in all_inside(folder) if not is_document(p)]


def documents_inside(folder: Path) -> list[Path]:
    """The others: what no import takes unless a map names it."""
    return [p for p in all_inside(folder) if is_document(p)]


def all_inside(folder: Path) -> list[Path]:
    """Every file below a folder, numbers in names in their order."""
    return sorted((p for p in folder.rglob("*") if p.is_file()), key=_natural)


def _matches(name: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(name, f"*/{pattern}")


def assign(sources: Sequence[Path], entries: Sequence[ExperimentMap]) -> list[tuple[ExperimentMap, Path]]:
    """Each entry of the map with each file that it takes."""
    pairs: list[tuple[ExperimentMap, Path]] = []
    for entry in entries:
        names = [pair for source in sources for pair in _with_names(source, entry.file)]
        taken = [(entry, path) for path, name in names if _matches(name, entry.file)]
        if not taken and any(s.is_dir() for s in sources):
            raise InputError(f"map: no file matches {entry.file!r} below {', '.join(map(str, sources))}")
        pairs += taken
    if not pairs:
        raise InputError(
            f"map: no experiment takes {', '.join(map(str, sources))}; the map's 'file' patterns are "
            f"{[e.file for e in entries]}"
        )
    return pairs


def _with_names(source: Path, pattern: str) -> list[tuple[Path, str]]:
    """A file, or those inside a folder, each with the name that a pattern is compared with."""
    if not source.is_dir():
        return [(source, source.as_posix())]
    inside = files_inside(source) if pattern in _ANY else all_inside(source)
    return [(path, path.relative_to(source).as_posix()) for path in inside]


_ANY = ("*", "**", "**/*")


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
        size = max(c.size for c in table.columns.values())
        instants, origin, said = read_clock(table, source.time, np.arange(size), str(path))
        whole = {n: c for n, c in table.columns.items() if c.size == instants.size and n != "time"}
        own = {f"{source.name}:{n}": c for n, c in whole.items()}
        columns |= {clock: frozen_float(instants + (origin + source.shift_s)), **own}
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
