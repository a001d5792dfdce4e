"""CAN logs as tables: frames by the fields of a map, an EDS or a database, one row per SYNC.

A row is one cycle: values that drives send in answer to SYNC k (TPDOs) stand in row k; a value the
master sends (RPDO) acts from the next SYNC on and stands in that row, held until the next one. Messages of a
database keep a clock of their own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, Int64, frozen_float
from invid.recording.import_map import Pdo, Source
from invid.recording.readers.text_dialect import roughness
from invid.recording.tables import BrokenRow, Table
from invid_drivers.can_log.fields import Field, fields_of_database, fields_of_pdo, listed, pdos_of_eds
from invid_drivers.can_log.frames import Frames, read_frames
from invid_drivers.can_log.guess import LOOKED_AT, SMOOTH, Guess, guess_pdos
from invid_drivers.can_log.traffic import chosen_frames, first_of_pairs, paired_by

ROUGH = 0.5
"""Mean square of a step over the variance from which a signal leaps: twice what counts as smooth."""


def read_log(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a log, named as in the map's PDOs; ``time`` is the SYNC instants [s] from the first one."""
    frames = read_frames(path)
    if source.dbc is not None:
        return _by_message(
            path, frames, fields_of_database((beside or Path()) / source.dbc, frames.counts()), source
        )
    pdos, remarks = list(source.pdos), tuple[str, ...]()
    if source.eds is not None:
        mapped, remarks = pdos_of_eds((beside or Path()) / source.eds, source.nodes)
        pdos += mapped
    guessed: Guess | None = None
    if not pdos:
        head = frames.where(np.arange(frames["time"].size) < LOOKED_AT)
        guessed = guess_pdos(head, source.sync_id)
        pdos, source = list(guessed.pdos), source.model_copy(update={"sync_id": guessed.sync_id})
    if not pdos:
        raise InputError(
            f"{path}: a CAN log needs 'pdos', 'dbc' (or 'eds' and 'nodes') in the map's 'source': which "
            "identifier "
            f"carries which objects; the log has identifiers {listed(frames.counts())}",
            way_out="without SYNC say 'sync_id: null' there as well",
            code="fields_unknown",
            values={"identifiers": list(frames.counts())[:12]},
        )
    fields = {pdo.id: fields_of_pdo(pdo, source.byte_order) for pdo in pdos}
    names = [f.name for own in fields.values() for f in own]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: signal names in 'pdos' must differ, found {names}")
    if "time" in names:
        raise InputError(f"{path}: 'time' is the column of SYNC instants; give the signal another name")
    table = replace(_rows(path, source, frames, fields, pdos), remarks=remarks)
    if guessed is None:
        return table
    said = {"pdos": [p.model_dump(exclude_none=True) for p in pdos], "sync_id": guessed.sync_id}
    unknown = "which field of the PDOs is what, and its unit: name position and torque by hand"
    return replace(
        table, notes={**table.notes, **said}, reasons=guessed.reasons, units={**table.units, **guessed.units},
        remarks=guessed.remarks if guessed.units else (*guessed.remarks, unknown),
    )  # fmt: skip


def _rows(
    path: Path, source: Source, frames: Frames, fields: dict[int, list[Field]], pdos: list[Pdo]
) -> Table:
    clock = source.sync_id if source.sync_id is not None else pdos[0].id
    own = chosen_frames(frames, source, list(fields), clock, path)
    if source.echo == "first":
        own = first_of_pairs(own, clock)
    at = np.flatnonzero(own["identifier"] == clock)
    if at.size < 3:
        what = f"SYNC (0x{clock:X})" if source.sync_id is not None else f"frame 0x{clock:X}"
        raise InputError(
            f"{path}: {what} comes {at.size} times in the log; the map's 'sync_id' may be wrong "
            f"(the log has identifiers {listed(frames.counts())}; null takes a sample at each frame of the "
            "first PDO)",
            code="no_sync",
            values={"sync_id": clock, "frames": int(at.size)},
        )
    broken = list(frames.broken)
    columns: dict[str, Float64] = {}
    for pdo in pdos:
        columns |= _columns(own, at, pdo, fields[pdo.id], path, broken)
    data = np.stack(list(columns.values()), axis=1)
    if source.echo is None and (apart := paired_by(own["time"][at], data)) is not None:
        raise InputError(
            f"{path}: SYNC (0x{clock:X}) comes in pairs, {1e3 * apart:.3g} ms apart: frames are logged "
            "twice, as sent and as heard",
            way_out="say 'echo: first' in the map's 'source' to read the first of each pair",
            code="logged_twice",
            values={"apart_ms": 1e3 * apart},
        )
    # The log starts and stops in the middle of things: cycles that no drive has answered yet are no fault.
    whole = np.flatnonzero(np.isfinite(data).all(axis=1))
    if whole.size == 0:
        empty = [n for n, c in columns.items() if not np.isfinite(c).any()]
        raise InputError(
            f"{path}: no cycle carries every signal of the map; never seen: {empty or 'all at once'}; the "
            f"log has identifiers {listed(frames.counts())}",
            code="no_whole_cycle",
        )
    part = slice(int(whole[0]), int(whole[-1]) + 1)
    # Epoch stamps keep 0.2 µs in a float64: counted from the first SYNC they keep all the log has.
    instants = own["time"][at][part]
    told = {s.name for pdo in pdos for s in pdo.signals if s.byte_order is not None}
    _refuse_wrong_bytes(own, [f for fs in fields.values() for f in fs if f.name not in told], fields, path)
    return Table(
        name=str(path),
        columns={"time": frozen_float(instants - instants[0])}
        | {n: frozen_float(c[part]) for n, c in columns.items()},
        lines=own["number"][at][part],
        line_word="line" if frames.is_text else "frame",
        notes={"sync_id": clock},
        broken=tuple(broken),
        units={"time": "s"},
        sums={"time": own["elapsed"][at][part]},
    )


def _columns(
    frames: Frames, clock: Int64, pdo: Pdo, fields: list[Field], path: Path, broken: list[BrokenRow]
) -> dict[str, Float64]:
    """(rows,) values of the fields of a PDO: the last of each cycle; what the master sends is held."""
    mine = frames["identifier"] == pdo.id
    own, to_drive = frames.where(mine), pdo.direction == "to_drive"
    rows = np.searchsorted(clock, np.flatnonzero(mine), side="right") - (0 if to_drive else 1)
    rows[(rows < 0) | (rows >= clock.size)] = clock.size
    there = own["length"] * 8 >= max((f.start + f.bits for f in fields), default=0)
    for row in np.flatnonzero(~there).tolist():
        reason = f"frame 0x{pdo.id:X} has {int(own['length'][row])} bytes only"
        broken.append(BrokenRow(path.name, int(own["number"][row]), reason))
    columns = {}
    for field in fields:
        values = np.full(clock.size + 1, np.nan)
        values[rows[there]] = field.values(own)[there]
        values = values[:-1]
        if to_drive:
            known = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(clock.size), -1))
            values = np.where(known >= 0, values[known], np.nan)
        columns[field.name] = values
    return columns


def _by_message(path: Path, frames: Frames, fields: dict[int, list[Field]], source: Source) -> Table:
    """A column a signal of a database, and a clock a message."""
    own = chosen_frames(frames, source, list(fields), next(iter(fields)), path)
    columns: dict[str, Float64] = {}
    clocks: dict[str, str] = {}
    units: dict[str, str] = {}
    start = float(own["time"][0]) if own["time"].size else 0.0
    for identifier, signals in fields.items():
        mine = own.where(own["identifier"] == identifier)
        for group in {f.mux[1] if f.mux else frozenset(): f for f in signals}:
            there = [f for f in signals if (f.mux[1] if f.mux else frozenset()) == group]
            rows = there[0].present(mine)
            if int(rows.sum()) < 2:
                continue
            message = there[0].name.split(".")[0] + "".join(f" {g}" for g in sorted(group))
            clock, part = f"time of {message}", mine.where(rows)
            columns[clock], units[clock] = frozen_float(part["time"] - start), "s"
            for f in there:
                columns[f.name], clocks[f.name] = frozen_float(f.values(part)), clock
                units |= {f.name: f.unit} if f.unit else {}
    if not clocks:
        raise InputError(f"{path}: holds no message of the database twice", code="no_frames")
    return Table(
        str(path), columns, line_word="frame", units=units, clocks=clocks, broken=frames.broken,
        reasons=("the columns are those of the database",),
    )  # fmt: skip


def _refuse_wrong_bytes(
    frames: Frames, untold: list[Field], fields: dict[int, list[Field]], path: Path
) -> None:
    """InputError where a signal leaps as it is read and moves smoothly with its bytes the other way round."""
    identifiers = {f.name: i for i, own in fields.items() for f in own}
    for field in untold:
        if field.kind == "float" or field.bits % 8 or field.bits == 8:
            continue
        own = frames.where(frames["identifier"] == identifiers[field.name])
        if not roughness(field.values(own)) > ROUGH:
            continue
        if roughness(field.values(own, swapped=True)) < SMOOTH:
            now, other = ("big", "little") if field.big else ("little", "big")
            raise InputError(
                f"{path}: {field.name!r} leaps from row to row read as {now}-endian, and moves smoothly with "
                "its bytes the other way round",
                way_out=f"say 'byte_order: {other}' beside its 'type' (or for all in the map's 'source'), "
                "'byte_order: "
                f"{now}' there if it leaps indeed",
                code="byte_order",
            )
