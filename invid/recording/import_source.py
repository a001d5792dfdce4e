"""Measured data from elsewhere: with a map, a guessed one, or as it is; and what a map would read."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invid.errors import ChoiceNeeded, InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.clock import count_slots
from invid.recording.hdf5 import read_recording
from invid.recording.import_map import ImportMap, Source
from invid.recording.importer import Import, import_files
from invid.recording.model import Experiment, Recording
from invid.recording.readers.kinds import read_table
from invid.recording.record_files import assign, files_inside, named_files
from invid.recording.spool import is_spool
from invid.recording.stored import FORMAT
from invid.recording.suggest import Found, Suggestion, suggest_for_all, together


def import_source(
    sources: Sequence[Path], chart: ImportMap | None, *, created: str, beside: Path | None = None
) -> Import:
    """What ``import_files`` yields; without a map a recording as it is, or a map where no column is in doubt.

    Parameters
    ----------
    sources
        Files, or one folder that the map's ``file`` patterns pick from.
    chart
        The map; ``None``: what was assumed instead stands in the result's warnings.
    created
        ISO 8601 time for the recording.
    beside
        Folder of the map, where an EDS it names is looked for.

    Raises
    ------
    InputError
        Files that cannot be read; columns whose meaning the map, or without one their names, do not tell.
    """
    if chart is not None:
        return import_files(sources, chart, created=created, beside=beside)
    ready = recording_as_it_is(sources)
    if ready is not None:
        return Import(ready, (), 0, ())
    chart, assumed = guess_map(sources)
    result = import_files(sources, chart, created=created, beside=beside)
    return replace(result, warnings=(*assumed, *result.warnings))


def recording_as_it_is(sources: Sequence[Path]) -> Recording | None:
    """The recording that the one file already is; ``None`` where it is none."""
    if len(sources) != 1 or not sources[0].is_file():
        return None
    named: Any = FORMAT if is_spool(sources[0]) else None
    with suppress(OSError, RuntimeError, ValueError, TypeError), h5py.File(sources[0], "r") as file:
        named = file.attrs.get("format")
    named = named.decode("latin-1") if isinstance(named, bytes) else named
    return read_recording(sources[0]) if isinstance(named, str) and named == FORMAT else None


def guess_map(sources: Sequence[Path]) -> tuple[ImportMap, tuple[str, ...]]:
    """A map without a person's help and what it assumes: only where every column's name is plain."""
    path, proposal = suggest_map(sources, None)
    doubts = [u for u in proposal.unsure if not u.endswith("is assumed")]
    doubts += [f"{key} is needed: {question}" for key, question in proposal.asked.items()]
    if doubts:
        raise InputError(
            f"{path}: cannot tell the columns without a map: {doubts[0]}",
            way_out=f"write a first map with 'invid import --suggest {path}', correct it and give it with "
            "--map",
            code="map_needed",
        )
    return proposal.as_map(), tuple(f"no map was given: {u}" for u in proposal.unsure)


MOST_FILES = 50
"""Files that a suggestion looks at; the others are said to be unread."""


def suggest_map(
    sources: Sequence[Path], chart: ImportMap | None, beside: Path | None = None
) -> tuple[Path, Suggestion]:
    """A first map for all the files, with the reason for every guess; ``chart`` says how to read them."""
    files = [f for s in sources for f in (files_inside(s) if s.is_dir() else [s])]
    if not files:
        raise InputError(f"{sources[0]}: the folder is empty")
    source = chart.source if chart else Source()
    path, proposal = suggest_for_all([_found(f, source, beside) for f in files[:MOST_FILES]])
    if len(files) > MOST_FILES:
        rest = f"{len(files) - MOST_FILES} of {len(files)} files were not looked at"
        proposal.unsure.insert(0, rest)
    if not proposal.asked:
        # Which columns are a guess; what they cannot tell is said before anything is fitted to them.
        with suppress(InputError):
            read = import_files([path], proposal.as_map(), created="1970-01-01T00:00:00+00:00")
            proposal.cannot_tell.extend(together([lack.text for lack in read.cannot_tell]))
    return path, proposal


def _found(path: Path, source: Source, beside: Path | None) -> Found:
    """The file's table; where it can be read in several ways the first of them, with the doubt."""
    # What the map says of reading them stays in the map.
    given: dict[str, Any] = source.model_dump(exclude_defaults=True, mode="json")
    chosen: dict[str, str | int] = {}
    doubts: list[str] = []
    while True:
        try:
            table = read_table(path, source.model_copy(update=chosen), beside=beside)
            return Found(path, table, given | chosen, tuple(doubts))
        except ChoiceNeeded as choice:
            if choice.key in chosen:
                return Found(path, None, error=choice)
            chosen[choice.key] = choice.value
            reason = str(choice).removeprefix(f"{path}: ")
            doubts.append(f"{choice.key} {choice.value!r} is taken, which may be another robot's: {reason}")
        except InputError as error:
            return Found(path, None, error=error)


def check_files(
    sources: Sequence[Path], chart: ImportMap, *, created: str, beside: Path | None
) -> tuple[dict[Path, Import | InputError], tuple[str, ...]]:
    """What every file that the map takes gives alone, or why nothing; a sentence for each that it leaves
    out."""
    files, left_out = named_files(sources, chart, beside)
    alone: dict[Path, ImportMap] = {files[0]: chart} if chart.sources else {}
    if not alone:
        by_file: dict[Path, list[Any]] = {}
        for entry, path in assign(files, chart.experiments):
            by_file.setdefault(path, []).append(entry.model_copy(update={"file": "*"}))
        for path, entries in by_file.items():
            alone[path] = chart.model_copy(update={"experiments": entries, "files": [], "skip": {}})
    found: dict[Path, Import | InputError] = {}
    for path, own in alone.items():
        try:
            taken = files if chart.sources else [path]
            found[path] = import_files(taken, own, created=created, beside=beside)
        except InputError as error:
            found[path] = error
    return found, left_out


def clock_time(e: Experiment) -> Float64:
    """(n,) [s] instants of the even clock that the rows keep, else their stamps: a late stamp is no speed."""
    slots = count_slots(e.time)
    return frozen_float(slots.index * slots.step if slots.even else e.time - e.time[0])


def describe_experiment(e: Experiment, recording: Recording) -> dict[str, Any]:
    """Rows, rate, gaps and the ranges of every axis in SI units of one experiment, for a table or JSON."""
    slots, time = count_slots(e.time), clock_time(e)
    axes = []
    for i, axis in enumerate(recording.axes):
        speed = np.diff(e.position[:, i]) / np.diff(time)
        axes.append(
            {
                "axis": axis,
                "position": _range(e.position[:, i]),
                # One row in a hundred may leap: a glitch is told elsewhere.
                "speed": [float(q) for q in np.quantile(speed, (0.01, 0.99))],
                "torque": _range(e.torque[:, i]),
            }
        )
    return {
        "key": e.key,
        "role": str(e.role),
        "rows": e.samples,
        "rate_hz": 1.0 / slots.step,
        "even": slots.even,
        "seconds": float(e.time[-1] - e.time[0]),
        "missing_rows": slots.lost if slots.even else 0,
        "jitter_ms": 1e3 * slots.jitter * slots.step if slots.even else None,
        "axes": axes,
    }


def _range(values: Float64) -> list[float]:
    return [float(values.min()), float(values.max())]
