"""Foreign tables and a map to a ``Recording``: units, signs, roles, broken rows counted and skipped."""

from __future__ import annotations

import fnmatch
import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, frozen, frozen_float
from invid.recording.cannot_tell import Lack, what_it_cannot_tell
from invid.recording.check import check_recording
from invid.recording.clock import StampsRead, count_slots, find_restarts, read_stamps
from invid.recording.import_map import AxisMap, Channel, Controller, ExperimentMap, ImportMap
from invid.recording.joined import read_joined
from invid.recording.meaning import EPISODE
from invid.recording.model import Experiment, Recording, nominal_sample_rate
from invid.recording.plausibility import doubt_of_sides, doubts, doubts_of_signs, held_rows, with_sign
from invid.recording.readers.kinds import is_document, read_table
from invid.recording.tables import BrokenRow, SparseRows, Table, good_rows, on_clock, slowest_rows
from invid.recording.units import BY_MACHINE, LINEAR, MachineConstants, Quantity, factor, normal_unit


@dataclass(frozen=True, eq=False)
class Import:
    """What an import yields: the recording, and what was skipped or assumed on the way."""

    recording: Recording
    broken: tuple[BrokenRow, ...]
    rows: int
    warnings: tuple[str, ...]
    cannot_tell: tuple[Lack, ...] = ()


def import_files(
    sources: Sequence[Path], chart: ImportMap, *, created: str, beside: Path | None = None
) -> Import:
    """All files through one map; parameters as of ``import_source``. Time is data here."""
    linear = _is_linear(chart)
    experiments: list[Experiment] = []
    broken: list[BrokenRow] = []
    sources, left_out = named_files(sources, chart, beside)
    warnings = [*left_out, *_unsaid(chart)]
    tables: dict[Path, Table] = {}
    read: dict[tuple[Path, tuple[str | int, ...], tuple[int, int, int]], _Rows] = {}
    counted: dict[Path, int] = {}
    if chart.sources:
        files = [f for s in sources for f in (_all_inside(s) if s.is_dir() else [s])]
        tables = read_joined(files, chart.sources, beside)
        sources = list(tables)
    pairs = assign(sources, chart.experiments)
    several = len({path for _, path in pairs}) > 1
    for entry, path in pairs:
        with _named_with_way_out(path, several=several):
            if path not in tables:
                tables[path] = read_table(path, chart.source, beside=beside)
            warnings += [f"{path.name}: {r}" for r in tables[path].remarks]
            own = chart.read_for(entry).renamed(tables[path].aliases)
            needed = tuple(own.columns())
            table, moved = _on_one_clock(tables[path], own)
            spans, split = _spans(table, entry, own, f"{path}: experiment {len(experiments):03d}")
            warnings += [f"{path.name}: {s}" for s in split]
            for span in spans:
                if (path, needed, span) not in read:
                    rows_read, skipped, remarks = _usable_rows(table, own, span, path)
                    read[path, needed, span] = rows_read
                    broken += [b for b in skipped if b not in broken]
                    told = (*moved, *remarks, *_doubts_of_columns(rows_read, own))
                    warnings += [f"{path.name}: {m}" for m in told]
                counted[path] = max(counted.get(path, 0), read[path, needed, span].good.size)
                experiment, lost_period = _experiment(
                    f"{len(experiments):03d}", entry, read[path, needed, span], own, path
                )
                experiments.append(experiment)
                warnings += lost_period
    for path in sources:
        if path.is_file() and path not in tables:
            raise InputError(f"{path}: no experiment of the map takes this file; see 'file' in the map")
    recording = Recording(
        robot=chart.robot,
        axes=tuple(a.name for a in chart.axes),
        position_unit="m" if linear else "rad",
        torque_unit="N" if linear else "N·m",
        created=created,
        experiments=tuple(experiments),
        masses_per_axis=_every([a.masses for a in chart.axes]),
        rated_torque=_vector(_every([a.rated_torque for a in chart.axes])),
        encoder_resolution=_vector(_every([_resolution(a) for a in chart.axes])),
        attributes={"imported_by": "invid import", "broken_rows": len(broken), **chart.attributes},
        source=", ".join(str(s) for s in sources),
    )
    check_recording(recording)
    warnings += doubts(recording)
    rows = max(sum(counted.values()), 1)
    return Import(
        recording, tuple(broken), rows, tuple(dict.fromkeys(warnings)), what_it_cannot_tell(recording)
    )


@contextmanager
def _named_with_way_out(path: Path, *, several: bool) -> Iterator[None]:
    """Context manager that adds to an error of one of several files how to do without it."""
    try:
        yield
    except InputError as error:
        if not several:
            raise
        raise InputError(
            str(error),
            way_out=f"to read the others without this file, write 'skip: {{{path.name!r}: the reason}}' in "
            "the map",
            code=error.code,
            values=error.values,
        ) from None


def _unsaid(chart: ImportMap) -> list[str]:
    """Return sentences on what the map leaves open and a diagnosis depends on."""
    return [
        f"axis {a.name}: the map does not say the 'meaning' of its torque; 'measured' is assumed (a torque "
        "that was only asked for is 'demanded': the drive's delay then counts as the machine's)"
        for a in chart.axes
        if a.torque is not None and "meaning" not in a.torque.model_fields_set
    ] + [
        f"axis {a.name}: its torque is what the stated 'controller' asks for, not a measured one: the "
        "drive's delay "
        "and what it loses count as the machine's"
        for a in chart.axes
        if a.torque is None
    ]


def _every(values: Sequence[Any]) -> Any:
    return None if any(v is None for v in values) else tuple(values)


def _vector(values: Any) -> Float64 | None:
    return None if values is None else frozen_float(values)


def _resolution(axis: AxisMap) -> float | None:
    if axis.encoder_resolution is not None:
        return axis.encoder_resolution
    p = axis.position
    return (
        p.per_count * p.scale if p is not None and p.per_count and normal_unit(p.unit) == "counts" else None
    )


def _is_linear(chart: ImportMap) -> bool:
    said: dict[bool, str] = {}
    for axis in chart.axes:
        for quantity in ("position", "velocity", "torque"):
            channel = getattr(axis, quantity)
            if channel is None:
                continue
            unit = normal_unit(channel.unit)
            if unit in LINEAR[quantity]:
                said[True] = f"{quantity} of {axis.name} in {channel.unit}"
            elif unit not in ("raw", *BY_MACHINE):
                said[False] = f"{quantity} of {axis.name} in {channel.unit}"
    if len(said) == 2:
        raise InputError(
            f"map: {said[True]} is linear but {said[False]} is rotary; one recording is one or the other"
        )
    if not said and chart.motion is None:
        raise InputError(
            "map: no unit tells a rotary from a linear machine; add 'motion: rotary' or 'motion: linear'"
        )
    linear = next(iter(said)) if said else chart.motion == "linear"
    if said and chart.motion is not None and linear != (chart.motion == "linear"):
        raise InputError(f"map: 'motion' is {chart.motion}, but {said[linear]}")
    return linear


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
    every = [f for s in found for f in (_all_inside(s) if s.is_dir() else [s])]
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
    return [p for p in _all_inside(folder) if not is_document(p)]


def documents_inside(folder: Path) -> list[Path]:
    """The others: what no import takes unless a map names it."""
    return [p for p in _all_inside(folder) if is_document(p)]


def _all_inside(folder: Path) -> list[Path]:
    return sorted((p for p in folder.rglob("*") if p.is_file()), key=_natural)


def _matches(name: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(name, f"*/{pattern}")


def assign(sources: Sequence[Path], entries: Sequence[ExperimentMap]) -> list[tuple[ExperimentMap, Path]]:
    """Each entry of the map with each file that it takes."""
    pairs: list[tuple[ExperimentMap, Path]] = []
    for entry in entries:
        found = False
        for source in sources:
            if source.is_dir():
                inside = files_inside(source) if entry.file in _ANY else _all_inside(source)
                names = [(p, p.relative_to(source).as_posix()) for p in inside]
            else:
                names = [(source, source.as_posix())]
            taken = [(entry, path) for path, name in names if _matches(name, entry.file)]
            pairs += taken
            found = found or bool(taken)
        if not found and any(s.is_dir() for s in sources):
            raise InputError(f"map: no file matches {entry.file!r} below {', '.join(map(str, sources))}")
    if not pairs:
        raise InputError(
            f"map: no experiment takes {', '.join(map(str, sources))}; the map's 'file' patterns are "
            f"{[e.file for e in entries]}"
        )
    return pairs


_ANY = ("*", "**", "**/*")


def _feedforward(chart: ImportMap) -> set[str | int]:
    return {a.torque_feedforward.column for a in chart.axes if a.torque_feedforward is not None}


def _on_one_clock(table: Table, chart: ImportMap) -> tuple[Table, tuple[str, ...]]:
    time = chart.time.column
    if not table.clocks or not isinstance(time, str) or time not in table.clocks.values():
        return table, ()
    needed = [n for n in chart.columns() if isinstance(n, str) and n in table.columns]
    return on_clock(table, time, needed)


@dataclass(frozen=True, eq=False)
class _Rows:
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


def _spans(
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
        if EPISODE.match(name) and column.size == size and np.isfinite(column).all():
            starts = np.flatnonzero(np.diff(column) != 0) + 1
            if 0 < starts.size * 16 < size and bool(np.all(column == np.rint(column))):
                return starts.tolist(), f"{name!r} says where records end"
    said = chart.time
    if said.column is None:
        return [], ""
    unit = factor("time", said.unit, MachineConstants(), "map: time")
    how = StampsRead(str(said.column), unit, said.wraps_at, said.differences)
    return find_restarts(table.column(said.column) * unit, how), f"the clock {said.column!r} starts anew"


def _usable_rows(
    table: Table, chart: ImportMap, span: tuple[int, int, int], path: Path
) -> tuple[_Rows, list[BrokenRow], tuple[str, ...]]:
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
    rows = _Rows(table, good, np.flatnonzero(good), int(inside.sum()), each, instants, origin, sparse)
    return rows, skipped, (*told, *remarks)


def _doubts_of_columns(rows: _Rows, chart: ImportMap) -> list[str]:
    """Return what the names and the bare numbers of the map's columns say against their reading."""
    said, bare = [], []
    for axis in chart.axes:
        motion = axis.position or axis.velocity
        names = [c.column for c in (axis.torque, motion) if c is not None and isinstance(c.column, str)]
        doubt = doubt_of_sides(axis.name, *names) if len(names) == 2 else None
        said += [doubt] if doubt else []
        for field, channel in axis.channels().items():
            # Positions that wrap are unwrapped where they are read.
            if channel.read_as is None and not field.startswith("position") and _has(rows.table, channel):
                numbers = rows.table.column(channel.column)[rows.use]
                bare.append((f"{field} of {axis.name}", str(channel.column), numbers))
    return [*said, *doubts_of_signs(bare)]


def _experiment(
    key: str, entry: ExperimentMap, rows: _Rows, chart: ImportMap, path: Path
) -> tuple[Experiment, list[str]]:
    where = f"{path}: experiment {key}"
    table, use = rows.table, rows.use
    period = round(entry.period_samples / rows.each)
    if abs(period * rows.each - entry.period_samples) > 0.01 * rows.each:
        raise InputError(
            f"{where}: 'period_samples' is {entry.period_samples} rows of the file, no whole number of the "
            f"{rows.each:.4g} rows that each value stands for; leave 'period_samples' out"
        )
    if period and use.size < period:
        raise InputError(
            f"{where}: 'period_samples' is {entry.period_samples}, but its rows leave {use.size} samples; a "
            f"periodic experiment holds at least one period (0: not periodic)"
        )
    remarks: list[str] = []
    if period and rows.asked != use.size:
        period = 0
        remarks.append(
            f"{path.name}: broken rows were skipped inside a periodic experiment, so it is no longer "
            f"periodic; choose rows without them"
        )
    time, offset = _time(rows, chart)

    def columns(pick: Callable[[AxisMap], Channel | None], quantity: Quantity) -> list[Float64 | None]:
        """One channel of every axis, in SI units; ``None`` where an axis has none."""
        picked = [(axis, pick(axis)) for axis in chart.axes]
        return [None if c is None else rows.values(c, a, quantity, where) for a, c in picked]

    velocity = columns(lambda a: a.velocity, "velocity")
    position = [
        p if v is None else integrated(time, v)
        for p, v in zip(columns(lambda a: a.position, "position"), velocity, strict=True)
    ]
    reference = columns(lambda a: a.position_reference, "position")
    # A feedforward may be logged in some of the files only: zero in the others.
    added = columns(lambda a: a.torque_feedforward if _has(table, a.torque_feedforward) else None, "torque")
    feedforward = [np.zeros(use.size) if f is None else f for f in added]
    torque = [
        _asked_for(a.controller, r, p, time) + f if t is None and a.controller and r is not None else t
        for t, a, r, p, f in zip(
            columns(lambda a: a.torque, "torque"), chart.axes, reference, position, feedforward, strict=True
        )
    ]
    sources = [a.torque.meaning if a.torque is not None else "demanded" for a in chart.axes]
    demand = [
        d if d is not None else t if m == "demanded" else None
        for d, t, m in zip(columns(lambda a: a.torque_demand, "torque"), torque, sources, strict=True)
    ]
    status = [None if a.status is None else rows.words(a.status) for a in chart.axes]
    words = _every(status)
    meanings = sorted(set(sources))
    attributes: dict[str, Any] = {
        "source_file": path.name,
        "torque_source": meanings[0] if len(meanings) == 1 else "mixed",
        **entry.attributes,
    }
    if offset:
        attributes["time_offset_s"] = offset
    velocity_only = [a.name for a in chart.axes if a.velocity is not None]
    if velocity_only:
        if len(velocity_only) != len(chart.axes):
            raise InputError(
                f"map: axes {velocity_only} give velocity only, the others position; use one kind"
            )
        attributes["position_source"] = "integrated_velocity"
    if any(a.controller is not None for a in chart.axes):
        laws = [None if a.controller is None else a.controller.model_dump() for a in chart.axes]
        attributes["controller"] = json.dumps(laws)
    experiment = Experiment(
        key=key,
        kind=entry.kind,
        role=entry.role,
        excited_axis=entry.excited_axis,
        hold_gain=frozen_float(np.zeros(len(chart.axes)) if entry.hold_gain is None else entry.hold_gain),
        period_samples=period,
        frequencies_hz=frozen_float(np.asarray(entry.frequencies_hz, dtype=float)),
        sample_rate_hz=(chart.time.sample_rate_hz or 0.0) / rows.each or _rate(time),
        time=time,
        position=_matrix(position),  # type: ignore[arg-type]
        torque=_matrix(torque),  # type: ignore[arg-type]
        torque_demand=_matrix(demand),
        status=None if words is None else frozen(np.stack(words, axis=1), np.uint16),  # type: ignore[arg-type]
        attributes=attributes,
        position_reference=_matrix(reference),
        torque_feedforward=_matrix(feedforward) if any(f.any() for f in feedforward) else None,
    )
    return experiment, remarks


def _asked_for(law: Controller, reference: Float64, position: Float64 | None, time: Float64) -> Float64:
    """(n,) torque that a known law asks for, by the even clock that the rows keep."""
    if position is None:
        raise InputError("map: a 'controller' without 'torque' needs 'position'")
    slots = count_slots(time)
    clock = slots.index * slots.step if slots.even else time
    torque: Float64 = law.stiffness * (reference - position) - law.damping * np.gradient(position, clock)
    return torque if law.limit is None else np.clip(torque, -law.limit, law.limit)


def _matrix(columns: Sequence[Float64 | None]) -> Float64 | None:
    """(n, M); ``None`` where an axis has none."""
    every = _every(columns)
    return None if every is None else frozen_float(np.stack(every, axis=1))


def _has(table: Table, channel: Channel | None) -> bool:
    return channel is not None and (isinstance(channel.column, int) or channel.column in table.columns)


def _rate(time: Float64) -> float:
    # The mean rate averages out the time stamps' rounding; with gaps or jitter the median is the nominal one.
    median = nominal_sample_rate(time)
    mean = (time.size - 1) / float(time[-1] - time[0])
    return mean if abs(mean / median - 1) < 0.01 else median


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


def _time(rows: _Rows, chart: ImportMap) -> tuple[Float64, float]:
    if rows.instants is None:
        return frozen_float(rows.use / (chart.time.sample_rate_hz or 1.0)), 0.0
    time = rows.instants[rows.use]
    offset = float(time[0]) if rows.origin else 0.0
    return frozen_float(time - offset), rows.origin + offset if rows.origin else 0.0


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


def integrated(time: Float64, velocity: Float64) -> Float64:
    """Position from velocity held over each sample, so that forward differences give it back exactly."""
    position: Float64 = np.concatenate(([0.0], np.cumsum(velocity[:-1] * np.diff(time))))
    return position
