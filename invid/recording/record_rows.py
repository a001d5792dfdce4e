"""The rows of a table that are one record, and their columns in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64
from invid.recording.clock import StampsRead, find_restarts, read_stamps
from invid.recording.import_map import AxisMap, Channel, ExperimentMap, ImportMap
from invid.recording.meaning import EPISODE
from invid.recording.plausibility import held_rows, with_sign
from invid.recording.tables import BrokenRow, SparseRows, Table, good_rows, on_clock, slowest_rows
from invid.recording.units import MachineConstants, Quantity, factor


def _feedforward(chart: ImportMap) -> set[str | int]:
    return {a.torque_feedforward.column for a in chart.axes if a.torque_feedforward is not None}


def on_one_clock(table: Table, chart: ImportMap) -> tuple[Table, tuple[str, ...]]:
    time = chart.time.column
    if not table.clocks or not isinstance(time, str) or time not in table.clocks.values():
        return table, ()
    needed = [n for n in chart.columns() if isinstance(n, str) and n in table.columns]
    return on_clock(table, time, needed)


@dataclass(frozen=True, eq=False)
class RecordRows:
    """The rows of a table that one or more experiments take.

    ``good`` is a mask of all rows, ``use`` their numbers, ``each`` the rows of the file that one stands for;
    ``instants`` [s] of all rows count from ``origin``.
    """

    table: Table
    good: Bool
    use: np.typing.NDArray[np.intp]
    asked: int
    each: float
    instants: Float64 | None
    origin: float
    sparse: SparseRows | None

    def values(self, channel: Channel, axis: AxisMap, quantity: Quantity, where: str) -> Float64:
        """(rows used,) SI values of a channel."""
        values = _values(self.table, channel, axis, quantity, where)
        return (values if self.sparse is None else self.sparse.bring(channel.column, values))[self.use]

    def words(self, column: str | int) -> Float64:
        """Return (rows used,) numbers that mean their bits: the last one known, never one between."""
        words = self.table.column(column)
        if self.sparse is not None:
            known = np.where(np.isfinite(words), np.arange(words.size), 0)
            words = words[np.maximum.accumulate(known)]
        return np.asarray(np.mod(np.round(words[self.use]), 65536), dtype=np.float64)


def record_spans(
    table: Table, entry: ExperimentMap, chart: ImportMap, where: str
) -> tuple[list[tuple[int, int, int]], list[str]]:
    """First row, the one after the last, and the step of each record in an experiment's rows; why there are
    several.

    Records are never joined: a column that numbers them, or a clock that starts anew, parts them.
    """
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
        spans.append((begin, end, entry.every))
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
    said = chart.time
    if said.column is None:
        return [], ""
    unit = factor("time", said.unit, MachineConstants(), "map: time")
    how = StampsRead(str(said.column), unit, said.wraps_at, said.differences)
    return find_restarts(table.column(said.column) * unit, how), f"the clock {said.column!r} starts anew"


def usable_rows(
    table: Table, chart: ImportMap, span: tuple[int, int, int], path: Path
) -> tuple[RecordRows, list[BrokenRow], tuple[str, ...]]:
    # A feedforward may be logged in some of the files only.
    needed = [n for n in chart.columns() if n not in _feedforward(chart) or n in table.columns]
    inside = np.zeros(table.column(needed[0]).size, dtype=np.bool_)
    inside[slice(*span)] = True
    each, told = float(span[2]), list[str]()
    sparse = slowest_rows(table, chart.time.column, needed)
    if sparse is not None:
        inside &= sparse.rows
        each, told = each * sparse.each, [sparse.remark]
    instants, origin, remarks = _instants(table, inside, chart, str(path))
    filled = {n: table.column(n) if sparse is None else sparse.bring(n, table.column(n)) for n in needed}
    good, skipped = good_rows(table, filled, instants, inside, path)
    rows = RecordRows(table, good, np.flatnonzero(good), int(inside.sum()), each, instants, origin, sparse)
    return rows, skipped, (*told, *remarks)


def _instants(
    table: Table, inside: Bool, chart: ImportMap, where: str
) -> tuple[Float64 | None, float, tuple[str, ...]]:
    """Instants [s] of the rows ``inside`` from the origin [s], the origin, and what was done about them."""
    said = chart.time
    if said.column is None:
        return None, 0.0, ()
    if said.column in table.stamped and said.unit != "s":
        raise InputError(
            f"{where}: time {said.column!r} holds dates or times of day, which are read as seconds; "
            f"its unit is {said.unit!r}, write 's'"
        )
    unit = factor("time", said.unit, MachineConstants(), f"{where}: time")
    raw = table.column(said.column)
    first = raw[inside & np.isfinite(raw)][:1]
    # Seconds since 1970 leave 0.2 µs in a float64: the start is taken out before anything is computed.
    origin = float(first[0]) if first.size and abs(first[0] * unit) > 1e6 else 0.0
    sums = table.sums.get(str(said.column))
    how = StampsRead(
        str(said.column),
        unit,
        None if said.wraps_at is None else said.wraps_at * unit,
        said.differences,
        None if sums is None else sums[inside] * unit,
    )
    stamps = read_stamps((raw[inside] - origin) * unit, how, where)
    instants = np.full(raw.size, np.nan)
    instants[inside] = stamps.instants
    return instants, origin * unit, stamps.remarks


def _values(table: Table, channel: Channel, axis: AxisMap, quantity: Quantity, where: str) -> Float64:
    constants = MachineConstants(
        torque_constant=getattr(channel, "torque_constant", None),
        rated_torque=axis.rated_torque,
        per_count=channel.per_count,
    )
    unit = factor(quantity, channel.unit, constants, f"{where}: {quantity} of {axis.name}")
    raw = table.column(channel.column)
    raw = (raw if channel.read_as is None else with_sign(raw, channel.read_as)) - channel.offset
    if channel.remove_mean:
        raw = raw - float(np.mean(raw[np.isfinite(raw)]))
    values: Float64 = channel.sign * channel.scale * unit * raw
    return values


def has_column(table: Table, channel: Channel | None) -> bool:
    return channel is not None and (isinstance(channel.column, int) or channel.column in table.columns)
