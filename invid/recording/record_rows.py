"""The rows of a table that are one record, and their columns in SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, Int64, frozen_float
from invid.recording.clock import find_restarts, read_stamps
from invid.recording.import_map import QUANTITIES, AxisMap, ExperimentMap, ImportMap, TimeMap
from invid.recording.meaning import EPISODE
from invid.recording.plausibility import held_rows, with_sign
from invid.recording.tables import BrokenRow, Table, at_slowest, good_rows, on_clock
from invid.recording.units import factor


@dataclass(frozen=True, eq=False)
class RecordRows:
    """The usable rows of a table that an experiment takes.

    Attributes
    ----------
    use
        (n,) their numbers in the table.
    time
        (n,) [s] their instants from ``origin`` [s].
    asked
        Rows that were to be taken, broken ones too; ``file_rows`` are all of the file.
    each
        Rows of the file that each stands for.
    skipped, remarks
        The broken ones, and what was done about the others.
    """

    table: Table
    use: Int64
    time: Float64
    origin: float
    asked: int
    file_rows: int
    each: float
    skipped: list[BrokenRow]
    remarks: tuple[str, ...]

    def values(self, axis: AxisMap, field: str, where: str) -> Float64 | None:
        """(n,) SI values of a channel of an axis; ``None`` where it has none."""
        channel = getattr(axis, field)
        # A feedforward may be logged in some of the files only.
        if channel is None or (field == "torque_feedforward" and not self.table.holds(channel.column)):
            return None
        constants = {**channel.model_dump(), "rated_torque": axis.rated_torque}
        quantity = QUANTITIES[field]
        unit = factor(quantity, channel.unit, constants, f"{where}: {quantity} of {axis.name}")
        raw = self.table.column(channel.column) - channel.offset
        if channel.remove_mean:
            raw = raw - float(np.mean(raw[np.isfinite(raw)]))
        values: Float64 = channel.sign * channel.scale * unit * raw[self.use]
        return values


def find_records(
    table: Table, entry: ExperimentMap, chart: ImportMap, path: Path, key: str
) -> tuple[list[RecordRows], list[str]]:
    """Each record in an experiment's rows, and what was done to part them and to bring them on one clock.

    Records are never joined: a column that numbers them, or a clock that starts anew, parts them.

    Raises
    ------
    InputError
        Columns that are not there, rows that are none, more broken rows than one per cent.
    """
    time, moved = chart.time.column, tuple[str, ...]()
    optional = {str(a.torque_feedforward.column) for a in chart.axes if a.torque_feedforward is not None}
    named = [n for n in chart.columns() if str(n) not in optional or table.holds(n)]
    if isinstance(time, str) and table.name_of(time) in table.clocks.values():
        needed = [table.name_of(n) for n in named if table.holds(n)]
        table, moved = on_clock(table, table.name_of(time), needed)
    needed = [table.name_of(n) for n in named]
    sizes = {n: table.columns[n].size for n in needed}
    if len(set(sizes.values())) != 1:
        found = ", ".join(f"{n!r} {size}" for n, size in sizes.items())
        raise InputError(f"{path}: the columns of the map differ in length: {found}")
    table = _with_signs(table, chart)
    spans, said = _spans(table, entry, chart, f"{path}: experiment {key}")
    measured = [n for n in needed if time is None or n != table.name_of(time)]
    words = {table.name_of(a.status) for a in chart.axes if a.status is not None}
    slow = at_slowest(table, time, measured, words)
    records = []
    for first, stop in spans:
        inside: Bool = (slow.rows >= first) & (slow.rows < stop) & ((slow.rows - first) % entry.every == 0)
        instants, origin, remarks = read_clock(slow.table, chart.time, slow.rows, str(path), inside)
        good, skipped = good_rows(slow.table, needed, instants, inside, path)
        use = np.flatnonzero(good)
        records.append(
            RecordRows(
                slow.table,
                use,
                frozen_float(instants[use]),
                origin,
                asked=int(inside.sum()),
                file_rows=sizes[needed[0]],
                each=entry.every * slow.each,
                skipped=skipped,
                remarks=(*moved, *filter(None, [slow.remark]), *remarks),
            )
        )
    return records, said


def _with_signs(table: Table, chart: ImportMap) -> Table:
    """The table with the signs that its whole numbers have lost."""
    signed = {
        table.name_of(c.column): with_sign(table.column(c.column), c.read_as)
        for axis in chart.axes
        for c in axis.channels().values()
        if c.read_as is not None and table.holds(c.column)
    }
    return replace(table, columns={**table.columns, **signed}) if signed else table


def _spans(
    table: Table, entry: ExperimentMap, chart: ImportMap, where: str
) -> tuple[list[tuple[int, int]], list[str]]:
    """First row and the one after the last of each record; why there are several."""
    size = table.column(chart.columns()[0]).size
    for edge in entry.rows:
        if edge is not None and abs(edge) > size:
            raise InputError(f"{where}: 'rows' is {list(entry.rows)}, but the file has {size} rows of data")
    first, stop, _ = slice(*entry.rows).indices(size)
    edges, why = _record_starts(table, chart, size)
    inner = [e for e in edges if first < e < stop]
    spans = []
    for begin, end in zip([first, *inner], [*inner, stop], strict=True):
        begin += entry.drop_periods * entry.period_samples
        if end - begin < 2 and inner:
            continue
        if end - begin < 2:
            raise InputError(
                f"{where}: rows {list(entry.rows)} leave {max(end - begin, 0)} samples of the file's {size}; "
                f"at least 2 are needed"
            )
        if entry.every > 1:
            measured = [table.column(a.torque.column)[begin:end] for a in chart.axes if a.torque is not None]
            hold = held_rows(np.stack(measured, axis=1)) if measured else None
            begin += hold.first % entry.every if hold is not None else 0
        spans.append((begin, end))
    return spans, [f"{why}: {len(spans)} records, an experiment each"] if inner else []


def _record_starts(table: Table, chart: ImportMap, size: int) -> tuple[list[int], str]:
    """Rows at which another record begins, and what says so."""
    for name, column in table.columns.items():
        if not EPISODE.match(name) or column.size != size or not np.isfinite(column).all():
            continue
        step = np.diff(column)
        starts = np.flatnonzero(step != 0) + 1
        # What goes on and off is a state, not a number of records.
        is_state = np.unique(column).size == 2 and bool((step < 0).any())
        if 0 < starts.size * 16 < size and not is_state and bool(np.all(column == np.rint(column))):
            return starts.tolist(), f"{name!r} says where records end"
    if chart.time.column is None:
        return [], ""
    how = chart.time.reading("map: time")
    starts_anew = f"the clock {chart.time.column!r} starts anew"
    return find_restarts(table.column(chart.time.column) * how.unit, how), starts_anew


def read_clock(
    table: Table, said: TimeMap, rows: Int64, where: str, inside: Bool | None = None
) -> tuple[Float64, float, tuple[str, ...]]:
    """Instants (n,) [s] of the rows ``inside`` from an origin [s], the origin, and what was done about them.

    ``rows`` (n,) are numbers in the file, which count at the map's rate where there is no column.
    """
    if said.column is None:
        return rows / (said.sample_rate_hz or 1.0), 0.0, ()
    name = table.name_of(said.column)
    if name in table.stamped and said.unit != "s":
        raise InputError(
            f"{where}: time {said.column!r} holds dates or times of day, which are read as seconds; "
            f"its unit is {said.unit!r}, write 's'"
        )
    raw = table.columns[name]
    inside = np.ones(raw.size, dtype=np.bool_) if inside is None else inside
    sums = table.sums.get(name)
    how = said.reading(f"{where}: time", None if sums is None else sums[inside])
    first = raw[inside & np.isfinite(raw)][:1]
    # Seconds since 1970 leave 0.2 µs in a float64: the start is taken out before anything is computed.
    origin = float(first[0]) if first.size and abs(first[0] * how.unit) > 1e6 else 0.0
    stamps = read_stamps((raw[inside] - origin) * how.unit, how, where)
    instants = np.full(raw.size, np.nan)
    instants[inside] = stamps.instants
    return instants, origin * how.unit, stamps.remarks
