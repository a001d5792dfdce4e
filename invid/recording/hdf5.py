"""Recordings as HDF5 by the contract: read strictly, written whole.

``read_recording`` accepts a file of the contract's shape written by anyone and turns every violation
into one sentence; ``write_recording`` writes under a temporary name and renames, so that a crash
leaves whatever stood there before. Writing while measuring is in ``invid.recording.writer``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from invid.errors import DiskFullError, InputError, RecordingError
from invid.model.document import save_bytes
from invid.numerics.arrays import Float64, UInt16, frozen, frozen_float
from invid.recording.attributes import ExperimentAttributes, RootAttributes
from invid.recording.check import COLUMNS, check_recording
from invid.recording.model import Experiment, Outcome, Recording
from invid.recording.spool import SUFFIX, as_hdf5, is_spool

FORMAT = "invid-recording"
FORMAT_VERSION = 1
MAX_VALUES = 200_000_000
"""Most numbers read from one file (1.6 GB as float64): eight axes at 1 kHz for an hour are 90 million.
A small compressed file can claim any size; the claim is checked before memory is taken."""
MAX_EXPERIMENTS = 10_000

# What else libhdf5 and h5py raise on a damaged file, depending on which byte is damaged.
_DAMAGED = (
    OSError,
    KeyError,
    RuntimeError,
    ValueError,
    TypeError,
    AttributeError,
    MemoryError,
    OverflowError,
)


@dataclass
class _Budget:
    left: int


def read_recording(path: str | Path) -> Recording:
    """The recording in an HDF5 file, or in the rows that a cut-off measurement left (``.rows``).

    Raises
    ------
    RecordingError
        Where the file is not there, not HDF5, damaged, or breaks the contract; one sentence says what,
        where and the value found.
    """
    path = Path(path)
    source = str(path)
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise RecordingError(f"{source}: is a directory; give the HDF5 file of a recording")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordingError(f"{source}: cannot be opened: {reason}{_rows_beside(path)}") from None
    if size == 0:
        raise RecordingError(f"{source}: the file is empty; it is not a recording")
    try:
        with as_hdf5(path) if is_spool(path) else h5py.File(path, "r") as file:
            recording = _read_root(file, source, _Budget(MAX_VALUES))
    except RecordingError:
        raise
    except _DAMAGED as error:
        raise RecordingError(_damage(path, source, error)) from None
    check_recording(recording)
    return recording


def _rows_beside(path: Path) -> str:
    """Return where a measurement that was cut off left its rows; empty where none did."""
    rows = path.with_name(path.name + SUFFIX)
    if not is_spool(rows):
        return ""
    return f"; its measurement was cut off, or still goes on: what it measured so far is in {rows}"


def _damage(path: Path, source: str, error: BaseException) -> str:
    first = " ".join(str(error).split())[:200]
    lowered = first.lower()
    if "unable to lock" in lowered:  # "block" is in most of what HDF5 says of damage
        return f"{source}: another program is writing this file; wait until it is done"
    try:
        with path.open("rb") as raw:
            signed = raw.read(8) == b"\x89HDF\r\n\x1a\n"
    except OSError as refused:
        return f"{source}: cannot be opened: {refused.strerror}"
    if not signed:
        return f"{source}: is not an HDF5 file; 'invid import' reads CSV, MAT, Parquet and CAN logs"
    if "truncated" in lowered:
        return f"{source}: the HDF5 file is truncated; copy it again from where it was written"
    return f"{source}: the HDF5 file is damaged or holds something unreadable ({first})"


def _read_root(file: h5py.File, source: str, budget: _Budget) -> Recording:
    if "format" not in file.attrs:
        raise RecordingError(
            f"{source}: attribute 'format' is missing; it is HDF5 but no invid recording "
            f"('invid import' reads HDF5 with other names)"
        )
    a = RootAttributes.of(file, source)
    if not a.axes:
        raise RecordingError(f"{source}: attribute 'axes' names no axis; at least one is needed")
    return Recording(
        robot=a.robot,
        axes=a.axes,
        position_unit=a.position_unit.strip(),
        torque_unit=a.torque_unit,
        created=a.created,
        experiments=_read_experiments(file, source, a.axes, a.outcome, budget),
        masses_per_axis=a.masses_per_axis,
        rated_torque=a.rated_torque,
        encoder_resolution=a.encoder_resolution,
        config=a.config,
        outcome=a.outcome,
        attributes=a.rest,
        source=source,
    )


def _read_experiments(
    file: h5py.File, source: str, axes: tuple[str, ...], outcome: Outcome | None, budget: _Budget
) -> tuple[Experiment, ...]:
    group = _own(file, "experiments", source)
    if not isinstance(group, h5py.Group):
        raise RecordingError(f"{source}: group '/experiments' is missing; a recording needs at least one")
    if len(group) > MAX_EXPERIMENTS:
        raise RecordingError(f"{source}: '/experiments' holds {len(group)} groups; at most {MAX_EXPERIMENTS}")
    keys = sorted(str(k) for k in group)
    experiments = []
    for position, key in enumerate(keys):
        where = f"{source}: experiment {key}"
        node = _own(group, key, where)
        if not isinstance(node, h5py.Group):
            raise RecordingError(f"{where}: '/experiments/{key}' is no group")
        # A measurement cut off by a crash may leave its last experiment without rows: that is no fault.
        unfinished = outcome is not Outcome.COMPLETED and position == len(keys) - 1 and position > 0
        if unfinished and _rows(node) < 2:
            continue
        experiments.append(_read_experiment(node, key, where, axes, budget))
    return tuple(experiments)


def _rows(node: h5py.Group) -> int:
    time = node.get("time")
    return int(time.shape[0]) if isinstance(time, h5py.Dataset) and time.shape else 0


def _own(parent: h5py.Group, name: str, where: str) -> Any:
    """Return the object of this name inside this very file; ``None`` where there is none."""
    link = parent.get(name, getlink=True)
    if link is None:
        return None
    if isinstance(link, h5py.ExternalLink):
        raise RecordingError(f"{where}: {name!r} is a link into another file; a recording must be whole")
    return parent.get(name)


def _read_experiment(
    node: h5py.Group, key: str, where: str, axes: tuple[str, ...], budget: _Budget
) -> Experiment:
    a = ExperimentAttributes.of(node, where)
    hold_gain = a.hold_gain if a.hold_gain.size != 1 else frozen_float(np.full(len(axes), a.hold_gain[0]))
    time = _dataset(node, "time", where, budget, columns=0)
    if time is None:
        raise RecordingError(f"{where}: dataset 'time' is missing; the contract needs it")
    columns: dict[str, Any] = {}
    for name in COLUMNS:
        values = _dataset(node, name, where, budget, columns=len(axes), rows=time.shape[0])
        if values is None and name in ("position", "torque"):
            raise RecordingError(f"{where}: dataset {name!r} is missing; the contract needs it")
        columns[name] = values
    return Experiment(
        key=key,
        kind=a.kind,
        role=a.role,
        excited_axis=a.excited_axis,
        hold_gain=hold_gain,
        period_samples=a.period_samples,
        frequencies_hz=a.frequencies_hz,
        sample_rate_hz=a.sample_rate_hz,
        time=time,
        position=columns["position"],
        torque=columns["torque"],
        torque_demand=columns["torque_demand"],
        position_reference=columns["position_reference"],
        torque_feedforward=columns["torque_feedforward"],
        status=_status(node, where, budget, columns=len(axes), rows=time.shape[0]),
        attributes=a.rest,
    )


def _status(node: h5py.Group, where: str, budget: _Budget, *, columns: int, rows: int) -> UInt16 | None:
    raw = _values(node, "status", where, budget, columns=columns, rows=rows)
    if raw is None:
        return None
    if raw.dtype != np.uint16 and not ((raw >= 0) & (raw <= 65535) & (raw == np.round(raw))).all():
        raise RecordingError(f"{where}: dataset 'status' holds values that are no 16-bit statuswords")
    return frozen(raw, np.uint16)  # type: ignore[return-value]


def _dataset(
    node: h5py.Group, name: str, where: str, budget: _Budget, *, columns: int, rows: int | None = None
) -> Float64 | None:
    raw = _values(node, name, where, budget, columns=columns, rows=rows)
    if raw is None:
        return None
    values: Float64 = np.ascontiguousarray(raw, dtype=np.float64)  # no copy: nobody else has it
    values.setflags(write=False)
    return values


def _values(
    node: h5py.Group, name: str, where: str, budget: _Budget, *, columns: int, rows: int | None
) -> npt.NDArray[Any] | None:
    data = _own(node, name, where)
    if data is None:
        return None
    if not isinstance(data, h5py.Dataset):
        raise RecordingError(f"{where}: {name!r} is no dataset")
    if data.is_virtual or data.external:
        raise RecordingError(f"{where}: dataset {name!r} lies in another file; a recording must be whole")
    if data.shape is None or data.dtype.kind not in "iuf":
        raise RecordingError(f"{where}: dataset {name!r} holds {data.dtype}, no real numbers")
    shape = tuple(int(s) for s in data.shape)
    needed = "[n]" if columns == 0 else f"({'n' if rows is None else rows}, {columns})"
    if len(shape) != (1 if columns == 0 else 2) or (columns and shape != (rows, columns)):
        hint = "; it is transposed: rows are samples, columns are axes" if shape == (columns, rows) else ""
        raise RecordingError(f"{where}: dataset {name!r} has shape {shape}; it must be {needed}{hint}")
    count = int(np.prod(shape, dtype=object))
    if count > budget.left:
        raise RecordingError(
            f"{where}: dataset {name!r} has shape {shape}: more numbers than this program reads from one file"
        )
    budget.left -= count
    # An early allocation of what a few bytes claim would be the bomb; a chunk that was never written is
    # not in the file, so the storage must at least exist.
    if count > 1_000_000 and data.id.get_storage_size() == 0:
        raise RecordingError(f"{where}: dataset {name!r} has shape {shape} but holds no data")
    values: npt.NDArray[Any] = data[()]
    return values


def root_attributes(recording: Recording) -> dict[str, Any]:
    """HDF5 attributes of the root group."""
    attributes: dict[str, Any] = {
        **recording.attributes,
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "created": recording.created,
        "robot": recording.robot,
        "axes": json.dumps(list(recording.axes), ensure_ascii=False),
        "position_unit": recording.position_unit,
        "torque_unit": recording.torque_unit,
    }
    if recording.masses_per_axis is not None:
        attributes["masses_per_axis"] = np.array(recording.masses_per_axis, dtype=np.int64)
    for name in ("rated_torque", "encoder_resolution", "config"):
        if getattr(recording, name) is not None:
            attributes[name] = getattr(recording, name)
    if recording.outcome is not None:
        attributes["outcome"] = str(recording.outcome)
    return attributes


def experiment_attributes(e: Experiment) -> dict[str, Any]:
    """HDF5 attributes of one experiment's group."""
    return {
        **e.attributes,
        "kind": str(e.kind),
        "excited_axis": e.excited_axis,
        "role": str(e.role),
        "hold_gain": np.asarray(e.hold_gain, dtype=np.float64),
        "period_samples": e.period_samples,
        "frequencies_hz": np.asarray(e.frequencies_hz, dtype=np.float64),
        "sample_rate_hz": e.sample_rate_hz,
    }


def set_attributes(node: h5py.HLObject, attributes: Mapping[str, Any]) -> None:
    """Write attributes; RecordingError names one that HDF5 cannot hold."""
    for name, value in attributes.items():
        try:
            node.attrs[name] = value
        except (TypeError, ValueError, OSError, RuntimeError) as error:
            raise RecordingError(f"attribute {name!r}: cannot be stored in HDF5: {error}") from None


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write ``recording`` by the contract: checked, under a temporary name, then renamed.

    Raises
    ------
    RecordingError
        Where the recording breaks the contract or the file cannot be written; a file already at
        ``path`` is then left as it was.
    """
    path = Path(path)
    check_recording(recording)
    try:
        # In memory first: libhdf5 that meets a full disk takes the process with it.
        with h5py.File(f"{path}.memory", "w", driver="core", backing_store=False) as file:
            set_attributes(file, root_attributes(recording))
            group = file.create_group("experiments")
            for e in recording.experiments:
                node = group.create_group(e.key)
                set_attributes(node, experiment_attributes(e))
                for name in ("time", *COLUMNS, "status"):
                    values = getattr(e, name)
                    if values is not None:
                        node.create_dataset(
                            name, data=values, compression="gzip", compression_opts=1, shuffle=True
                        )
            file.flush()
            image = file.id.get_file_image()
    except (ValueError, RuntimeError) as error:
        what = error if isinstance(error, RecordingError) else f"cannot be written: {error}"
        raise RecordingError(f"{path}: {what}") from None
    try:
        save_bytes(path, image)
    except DiskFullError:
        raise
    except InputError as error:
        raise RecordingError(str(error)) from None
