"""Recordings as HDF5 by the contract: read strictly, written whole.

``read_recording`` accepts a file of the contract's shape written by anyone and turns every violation
into one sentence; ``write_recording`` writes under a temporary name and renames, so that a crash
leaves whatever stood there before. Writing while measuring is in ``invid.recording.writer``.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invid.errors import DiskFullError, InputError, RecordingError
from invid.model.document import save_bytes
from invid.recording.check import check_recording
from invid.recording.model import Recording
from invid.recording.spool import MAGIC, SUFFIX, is_spool, read_spool
from invid.recording.stored import DATASETS, StoredExperiment, StoredRecording, stored

MAX_VALUES = 200_000_000
"""Most numbers read from one file (1.6 GB as float64): eight axes at 1 kHz for an hour are 90 million.
A small compressed file can claim any size; the claim is checked before memory is taken."""
MAX_EXPERIMENTS = 10_000
_GROWTH_BYTES = 4 << 20
# What libhdf5 and h5py raise on a damaged file, depending on which byte is damaged.
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


def read_recording(path: str | Path) -> Recording:
    """The recording in an HDF5 file, or in the rows that a cut-off measurement left (``.rows``).

    Raises
    ------
    RecordingError
        Where the file is not there, not HDF5, damaged, or breaks the contract; one sentence says what,
        where and the value found.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a directory; give the HDF5 file of a recording")
        with path.open("rb") as raw:
            head = raw.read(len(MAGIC))
    except (OSError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        rows = Path(f"{path}{SUFFIX}")
        said = "; its measurement was cut off, or still goes on: what it measured so far is in "
        beside = f"{said}{rows}" if is_spool(rows) else ""
        raise RecordingError(
            f"{path}: cannot be opened: {getattr(error, 'strerror', None) or error}{beside}"
        ) from None
    if not head:
        raise RecordingError(f"{path}: the file is empty; it is not a recording")
    try:
        if head == MAGIC:
            found = read_spool(path)
        else:
            with h5py.File(path, "r") as file:
                found = _read(file, str(path))
        recording = found.read(str(path))
    except RecordingError:
        raise
    except _DAMAGED as error:
        raise RecordingError(f"{path}: {_damage(head, error)}") from None
    check_recording(recording)
    return recording


def _damage(head: bytes, error: BaseException) -> str:
    """What is wrong with a file that begins with ``head``, by what HDF5 said of it."""
    first = " ".join(str(error).split())[:200]
    if "unable to lock" in first.lower():  # "block" is in most of what HDF5 says of damage
        return "another program is writing this file; wait until it is done"
    if not head.startswith(b"\x89HDF\r\n\x1a\n"):
        return "is not an HDF5 file; 'invid import' reads CSV, MAT, Parquet and CAN logs"
    if "truncated" in first.lower():
        return "the HDF5 file is truncated; copy it again from where it was written"
    return f"the HDF5 file is damaged or holds something unreadable ({first})"


def _read(file: h5py.File, source: str) -> StoredRecording:
    if "format" not in file.attrs:
        raise RecordingError(
            f"{source}: attribute 'format' is missing; it is HDF5 but no invid recording "
            f"('invid import' reads HDF5 with other names)"
        )
    group = _own(file, "experiments", source)
    if not isinstance(group, h5py.Group):
        raise RecordingError(f"{source}: group '/experiments' is missing; a recording needs at least one")
    if len(group) > MAX_EXPERIMENTS:
        raise RecordingError(f"{source}: '/experiments' holds {len(group)} groups; at most {MAX_EXPERIMENTS}")
    experiments, left = dict[str, StoredExperiment](), MAX_VALUES
    for key in sorted(str(k) for k in group):
        where = f"{source}: experiment {key}"
        node = _own(group, key, where)
        if not isinstance(node, h5py.Group):
            raise RecordingError(f"{where}: '/experiments/{key}' is no group")
        datasets = {}
        for name in ("time", *DATASETS):
            data = _own(node, name, where)
            if data is not None:
                left -= _count(data, f"{where}: dataset {name!r}", left)
                datasets[name] = data[()]
        experiments[key] = StoredExperiment(_attributes(node), datasets)
    return StoredRecording(_attributes(file), experiments)


def _own(parent: h5py.Group, name: str, where: str) -> Any:
    """Return the object of this name inside this very file; ``None`` where there is none."""
    link = parent.get(name, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        raise RecordingError(f"{where}: {name!r} is a link into another file; a recording must be whole")
    return None if link is None else parent.get(name)


def _count(data: Any, where: str, left: int) -> int:
    """How many numbers a dataset holds; RecordingError where it holds none, or more than are ``left`` to be
    read.
    """
    if not isinstance(data, h5py.Dataset):
        raise RecordingError(f"{where} is a group; it must be a dataset")
    if data.is_virtual or data.external:
        raise RecordingError(f"{where} lies in another file; a recording must be whole")
    if data.shape is None or data.dtype.kind not in "iuf":
        raise RecordingError(f"{where} holds {data.dtype}, no real numbers")
    count = int(np.prod(data.shape, dtype=object))
    if count > left:
        raise RecordingError(
            f"{where} has shape {data.shape}: more numbers than this program reads from one file"
        )
    # A chunk that was never written is not in the file: what a few bytes claim must at least exist.
    if count > 1_000_000 and data.id.get_storage_size() == 0:
        raise RecordingError(f"{where} has shape {data.shape} but holds no data")
    return count


def _attributes(node: h5py.HLObject) -> dict[str, Any]:
    """Attributes as plain values; one that is unreadable matters only where the contract needs it."""
    found = {}
    for name in list(node.attrs.keys()):
        with suppress(OSError, TypeError, ValueError, KeyError, RuntimeError):
            found[str(name)] = _plain(node.attrs[name])
    return found


def _plain(value: Any) -> Any:
    """Plain Python values of what HDF5 holds; a null dataspace is an empty list."""
    if isinstance(value, h5py.Empty):
        return []
    if isinstance(value, np.ndarray) and value.ndim:
        return [_plain(v) for v in value.ravel()]
    value = value.item() if isinstance(value, np.ndarray | np.generic) else value
    # h5py keeps undecodable bytes of a text as surrogates; they came from a Latin-1 writer.
    raw = value.encode("utf-8", "surrogateescape") if isinstance(value, str) else value
    if not isinstance(raw, bytes):
        return raw
    raw = raw.rstrip(b"\0")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def hdf5_image(content: StoredRecording) -> bytes:
    """The HDF5 file of a recording, made in memory: libhdf5 that meets a full disk takes the process with it.

    Raises
    ------
    RecordingError
        Something that HDF5 cannot hold.
    """
    with h5py.File("memory", "w", driver="core", backing_store=False, block_size=_GROWTH_BYTES) as file:
        _set_attributes(file, content.attributes)
        group = file.create_group("experiments")
        for key, experiment in content.experiments.items():
            node = group.create_group(key)
            _set_attributes(node, experiment.attributes)
            for name, values in experiment.datasets.items():
                node.create_dataset(name, data=values, compression="gzip", compression_opts=1, shuffle=True)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _set_attributes(node: h5py.HLObject, attributes: Mapping[str, Any]) -> None:
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
        image = hdf5_image(stored(recording))
    except (ValueError, RuntimeError) as error:
        what = error if isinstance(error, RecordingError) else f"cannot be written: {error}"
        raise RecordingError(f"{path}: {what}") from None
    try:
        save_bytes(path, image)
    except DiskFullError:
        raise
    except InputError as error:
        raise RecordingError(str(error)) from None
