"""Measured data from elsewhere, with a map, with a guessed one, or a recording as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py

from invid.errors import InputError
from invid.recording.hdf5 import FORMAT, read_recording
from invid.recording.import_map import ImportMap, Source
from invid.recording.importer import Import, import_files, read_table
from invid.recording.model import Recording
from invid.recording.spool import is_spool
from invid.recording.suggest import Suggestion, suggest


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
    if is_spool(sources[0]):
        return read_recording(sources[0])
    if not h5py.is_hdf5(sources[0]):
        return None
    try:
        with h5py.File(sources[0], "r") as file:
            named = file.attrs.get("format")
    except (OSError, RuntimeError, ValueError, TypeError):
        return None
    named = named.decode("latin-1") if isinstance(named, bytes) else named
    return read_recording(sources[0]) if isinstance(named, str) and named == FORMAT else None


def guess_map(sources: Sequence[Path]) -> tuple[ImportMap, tuple[str, ...]]:
    """A map without a person's help and what it assumes: only where every column's name is plain."""
    path, proposal = suggest_map(sources, None)
    doubts = [u for u in proposal.unsure if not u.endswith("is assumed")]
    doubts += [f"{key} is needed: {question}" for key, question in proposal.asked.items()]
    if doubts:
        raise InputError(
            f"{path}: cannot tell the columns without a map: {doubts[0]}; write a first map with "
            f"'invid import --suggest {path}', correct it and give it with --map"
        )
    return proposal.as_map(), tuple(f"no map was given: {u}" for u in proposal.unsure)


def suggest_map(sources: Sequence[Path], chart: ImportMap | None) -> tuple[Path, Suggestion]:
    """A first map for the first file, with the reason for every guess; ``chart`` says how to read it."""
    path = sources[0]
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        if not files:
            raise InputError(f"{path}: the folder is empty")
        path = files[0]
    return path, suggest(read_table(path, chart.source if chart else Source()), path)
