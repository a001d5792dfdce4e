"""Foreign tables and a map to a ``Recording``: units, signs, roles, broken rows counted and skipped."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen, frozen_float
from invid.recording.cannot_tell import Lack, what_it_cannot_tell
from invid.recording.check import check_recording
from invid.recording.clock import count_slots
from invid.recording.import_map import QUANTITIES, AxisMap, Controller, ExperimentMap, ImportMap
from invid.recording.model import Experiment, Recording, nominal_sample_rate
from invid.recording.plausibility import doubt_of_sides, doubts, doubts_of_signs
from invid.recording.readers.kinds import read_table
from invid.recording.record_files import all_inside, assign, named_files, read_joined
from invid.recording.record_rows import RecordRows, find_records
from invid.recording.tables import BrokenRow, Table
from invid.recording.units import BY_CONSTANT, LINEAR, normal_unit


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
    broken: dict[BrokenRow, None] = {}
    sources, left_out = named_files(sources, chart, beside)
    warnings = [*left_out, *_unsaid(chart)]
    tables: dict[Path, Table] = {}
    counted: dict[Path, int] = {}
    if chart.sources:
        files = [f for s in sources for f in (all_inside(s) if s.is_dir() else [s])]
        tables = read_joined(files, chart.sources, beside)
        sources = list(tables)
    pairs = assign(sources, chart.experiments)
    several = len({path for _, path in pairs}) > 1
    for entry, path in pairs:
        with _named_with_way_out(path, several=several):
            if path not in tables:
                tables[path] = read_table(path, chart.source, beside=beside)
            table = tables[path].renamed(entry.columns)
            records, parted = find_records(table, entry, chart, path, f"{len(experiments):03d}")
            said = [*table.remarks, *parted]
            for rows in records:
                experiment, remarks = _experiment(f"{len(experiments):03d}", entry, rows, chart, path)
                experiments.append(experiment)
                said += [*rows.remarks, *_doubts_of_columns(rows, chart), *remarks]
                broken |= dict.fromkeys(rows.skipped)
                counted[path] = rows.file_rows
            warnings += [f"{path.name}: {remark}" for remark in said]
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
    count = max(sum(counted.values()), 1)
    return Import(
        recording, tuple(broken), count, tuple(dict.fromkeys(warnings)), what_it_cannot_tell(recording)
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
    said = {
        normal_unit(channel.unit) in LINEAR[quantity]: f"{quantity} of {axis.name} in {channel.unit}"
        for axis in chart.axes
        for quantity in ("position", "velocity", "torque")
        if (channel := getattr(axis, quantity)) is not None
        and normal_unit(channel.unit) not in ("raw", *BY_CONSTANT)
    }
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


def _doubts_of_columns(rows: RecordRows, chart: ImportMap) -> list[str]:
    """Return what the names and the bare numbers of the map's columns say against their reading."""
    said, bare = [], []
    for axis in chart.axes:
        motion = axis.position or axis.velocity
        columns = [c.column for c in (axis.torque, motion) if c is not None and isinstance(c.column, str)]
        names = [rows.table.name_of(c) for c in columns]
        said += [doubt_of_sides(axis.name, *names)] if len(names) == 2 else []
        for field, channel in axis.channels().items():
            # Positions that wrap are unwrapped where they are read.
            is_bare = channel.read_as is None and not field.startswith("position")
            if is_bare and rows.table.holds(channel.column):
                name = rows.table.name_of(channel.column)
                bare.append((f"{field} of {axis.name}", name, rows.table.columns[name][rows.use]))
    return [*filter(None, said), *doubts_of_signs(bare)]


def _experiment(
    key: str, entry: ExperimentMap, rows: RecordRows, chart: ImportMap, path: Path
) -> tuple[Experiment, list[str]]:
    where = f"{path}: experiment {key}"
    period, remarks = _period(entry, rows, where, path)
    offset = float(rows.time[0]) if rows.origin else 0.0
    time = frozen_float(rows.time - offset)
    read = {field: [rows.values(axis, field, where) for axis in chart.axes] for field in QUANTITIES}
    position = [
        p if v is None else integrated(time, v)
        for p, v in zip(read["position"], read["velocity"], strict=True)
    ]
    feedforward = [np.zeros(time.size) if f is None else f for f in read["torque_feedforward"]]
    torque = [
        _asked_for(a.controller, r, p, time) + f if t is None and a.controller and r is not None else t
        for t, a, r, p, f in zip(
            read["torque"], chart.axes, read["position_reference"], position, feedforward, strict=True
        )
    ]
    sources = [a.torque.meaning if a.torque is not None else "demanded" for a in chart.axes]
    demand = [
        d if d is not None else t if m == "demanded" else None
        for d, t, m in zip(read["torque_demand"], torque, sources, strict=True)
    ]
    words = [None if a.status is None else rows.table.column(a.status)[rows.use] for a in chart.axes]
    attributes: dict[str, Any] = {
        "source_file": path.name,
        "torque_source": sources[0] if len(set(sources)) == 1 else "mixed",
        **entry.attributes,
    }
    if offset or rows.origin:
        attributes["time_offset_s"] = rows.origin + offset
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
        position=_matrix(position),
        torque=_matrix(torque),
        torque_demand=_matrix(demand),
        status=_matrix([None if w is None else np.mod(np.round(w), 65536) for w in words], np.uint16),
        attributes=attributes,
        position_reference=_matrix(read["position_reference"]),
        torque_feedforward=_matrix(feedforward) if any(f.any() for f in feedforward) else None,
    )
    return experiment, remarks


def _period(entry: ExperimentMap, rows: RecordRows, where: str, path: Path) -> tuple[int, list[str]]:
    """Samples of a period, 0 where it was lost with a broken row, which is said."""
    period = round(entry.period_samples / rows.each)
    if abs(period * rows.each - entry.period_samples) > 0.01 * rows.each:
        raise InputError(
            f"{where}: 'period_samples' is {entry.period_samples} rows of the file, no whole number of the "
            f"{rows.each:.4g} rows that each value stands for; leave 'period_samples' out"
        )
    if period and rows.use.size < period:
        raise InputError(
            f"{where}: 'period_samples' is {entry.period_samples}, but its rows leave {rows.use.size} "
            "samples; a periodic experiment holds at least one period (0: not periodic)"
        )
    if period and rows.asked != rows.use.size:
        return 0, [
            "broken rows were skipped inside a periodic experiment, so it is no longer periodic; choose rows "
            "without them"
        ]
    return period, []


def _asked_for(law: Controller, reference: Float64, position: Float64 | None, time: Float64) -> Float64:
    """(n,) torque that a known law asks for, by the even clock that the rows keep."""
    if position is None:
        raise InputError("map: a 'controller' without 'torque' needs 'position'")
    slots = count_slots(time)
    clock = slots.index * slots.step if slots.even else time
    torque: Float64 = law.stiffness * (reference - position) - law.damping * np.gradient(position, clock)
    return torque if law.limit is None else np.clip(torque, -law.limit, law.limit)


def _matrix(columns: Sequence[Float64 | None], kind: type[np.generic] = np.float64) -> Any:
    """(n, M); ``None`` where an axis has none."""
    every = _every(columns)
    return None if every is None else frozen(np.stack(every, axis=1), kind)


def _rate(time: Float64) -> float:
    # The mean rate averages out the time stamps' rounding; with gaps or jitter the median is the nominal one.
    median = nominal_sample_rate(time)
    mean = (time.size - 1) / float(time[-1] - time[0])
    return mean if abs(mean / median - 1) < 0.01 else median


def integrated(time: Float64, velocity: Float64) -> Float64:
    """Position from velocity held over each sample, so that forward differences give it back exactly."""
    position: Float64 = np.concatenate(([0.0], np.cumsum(velocity[:-1] * np.diff(time))))
    return position
