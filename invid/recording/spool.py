"""Keep the rows of a running measurement in a file that is only ever appended to.

libhdf5 that meets a full or failing disk loses its file and takes the process with it, when the objects it
could not write out are closed again at the interpreter's exit. So HDF5 never writes to the disk here: rows go
by plain ``write`` into this file, and become HDF5 in memory when the measurement has ended. What was written
before a cut is readable, whatever cut it: a frame that is not whole ends the reading. A killed process loses
what it had not written yet; a power cut what came after the last ``fdatasync`` besides.

A frame is its kind (1 byte), length and CRC-32 of its content (4 bytes each, little-endian), and the content:
JSON for the header, the beginning of an experiment and the outcome; for rows their number and then each
dataset of the experiment, row by row.
"""

from __future__ import annotations

import contextlib
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from invid.errors import RecordingError
from invid.recording.model import Outcome

MAGIC = b"invid-rows 1\n"
SUFFIX = ".rows"
_FRAME = struct.Struct("<BII")
_COUNT = struct.Struct("<I")
_HEADER, _BEGIN, _ROWS, _END, _OUTCOME = range(1, 6)
_LARGEST = 1 << 28
"""No frame is longer: a damaged length is not believed before memory is taken for it."""
_SYNC_S = 5.0
"""Data after which the disk is asked to keep the rows for good [s]: what a power cut may cost. A guess; it
costs a write of its own, which an old disk takes a tenth of a second for."""
_CHUNK_ROWS = 1024
_GROWTH_BYTES = 4 << 20


class Spool:
    """File that frames are appended to; what a failed write left half is taken off again."""

    def __init__(self, target: Path, header: Mapping[str, Any]) -> None:
        content = _json(header)
        target.parent.mkdir(parents=True, exist_ok=True)
        self.path, self._file = _free_file(target)
        self.size = 0
        self._synced_s: float | None = None
        try:
            self._write(MAGIC)
            self._frame(_HEADER, content)
            self._sync()
            sync_folder(target.parent)
        except OSError:
            self.close()
            self.remove()
            raise

    def begin(self, key: str, names: Sequence[str], attributes: Mapping[str, Any]) -> None:
        """Begin an experiment; ``names`` of its datasets, in the order in which rows bring them."""
        self._frame(_BEGIN, _json({"key": key, "names": list(names), "attributes": dict(attributes)}))

    def rows(self, columns: Sequence[npt.NDArray[Any]]) -> None:
        """Append rows of every dataset of the experiment, (k,) or (k, M)."""
        parts = [_COUNT.pack(columns[0].shape[0])]
        parts += [np.ascontiguousarray(c, c.dtype.newbyteorder("<")).tobytes() for c in columns]
        self._frame(_ROWS, b"".join(parts))
        last = float(columns[0][-1])
        if self._synced_s is None:
            self._synced_s = float(columns[0][0])
        if abs(last - self._synced_s) >= _SYNC_S:
            self._sync()
            self._synced_s = last

    def end(self) -> None:
        """End the experiment."""
        self._frame(_END, b"")
        self._sync()

    def outcome(self, outcome: str) -> None:
        """Write how the measurement ended."""
        self._frame(_OUTCOME, _json(outcome))

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def remove(self) -> None:
        """Delete the file: the rows are safe elsewhere."""
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _sync(self) -> None:
        os.fdatasync(self._file)

    def _frame(self, kind: int, content: bytes) -> None:
        self._write(_FRAME.pack(kind, len(content), zlib.crc32(content)) + content)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self.size)
                os.lseek(self._file, self.size, os.SEEK_SET)
            raise
        self.size += len(data)


def _free_file(target: Path) -> tuple[Path, int]:
    """A file of its own beside the target: rows that an earlier cut left there are never overwritten."""
    number = 1
    while True:
        path = target.with_name(f"{target.name}{'' if number == 1 else f'.{number}'}{SUFFIX}")
        try:
            return path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            number += 1


def sync_folder(folder: Path) -> None:
    """Have the disk keep the names in a folder for good, where its file system can."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(handle)
    finally:
        os.close(handle)


def is_spool(path: Path) -> bool:
    """Return whether a file holds the rows of a measurement."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def has_rows(path: Path) -> bool:
    """Return whether any row reached the disk."""
    return any(kind == _ROWS for kind, _ in _frames(path))


def as_hdf5(path: Path) -> h5py.File:
    """The rows of a file as HDF5 in memory; the caller closes it. Rows that nobody ended are marked "failed".

    Raises
    ------
    RecordingError
        Where not even the header is whole.
    """
    file = h5py.File(f"{path}.memory", "w", driver="core", backing_store=False, block_size=_GROWTH_BYTES)
    try:
        _fill(file, path)
    except BaseException:
        file.close()
        raise
    return file


def _fill(file: h5py.File, path: Path) -> None:
    experiments = file.create_group("experiments")
    group: h5py.Group | None = None
    begun: dict[str, Any] | None = None
    headed = False
    for kind, content in _frames(path):
        if kind == _HEADER:
            headed = True
            _set(file, {**_parsed(content), "outcome": str(Outcome.FAILED)})
        elif kind == _BEGIN:
            group, begun = None, _parsed(content)
        elif kind == _OUTCOME:
            file.attrs["outcome"] = str(_parsed(content))
        elif kind == _ROWS and begun is not None:
            if group is None:  # one without rows leaves no empty shell
                group = experiments.create_group(begun["key"])
                _set(group, begun["attributes"])
            _append(group, begun["names"], content, len(json.loads(str(file.attrs["axes"]))))
    if not headed:
        raise RecordingError(f"{path}: was cut off before its header was whole; it holds no measurement")


def _append(group: h5py.Group, names: Sequence[str], content: bytes, axes: int) -> None:
    (count,) = _COUNT.unpack_from(content)
    at = _COUNT.size
    for name in names:
        width = () if name == "time" else (axes,)
        kind = np.dtype("<u2") if name == "status" else np.dtype("<f8")
        values = np.frombuffer(content, kind, count * (axes if width else 1), at).reshape(count, *width)
        at += values.nbytes
        if name not in group:
            group.create_dataset(
                name,
                shape=(0, *width),
                maxshape=(None, *width),
                chunks=(_CHUNK_ROWS, *width),
                dtype=kind.newbyteorder("="),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
            )
        dataset = group[name]
        start = dataset.shape[0]
        dataset.resize(start + count, axis=0)
        dataset[start:] = values


def _frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield whole frames, to the first that is not."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        while len(head := file.read(_FRAME.size)) == _FRAME.size:
            kind, length, check = _FRAME.unpack(head)
            if length > _LARGEST:
                return
            content = file.read(length)
            if len(content) < length or zlib.crc32(content) != check:
                return
            yield kind, content


def _set(node: h5py.HLObject, attributes: Mapping[str, Any]) -> None:
    for name, value in attributes.items():
        node.attrs[name] = value


def _json(value: Any) -> bytes:
    try:
        return json.dumps(value, ensure_ascii=False, default=_plain).encode()
    except (TypeError, ValueError) as error:
        raise RecordingError(f"an attribute cannot be stored: {error}") from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
        return {"dtype": value.dtype.str, "array": value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no number, text or array of numbers")


def _parsed(content: bytes) -> Any:
    return json.loads(content, object_hook=_array)


def _array(value: dict[str, Any]) -> Any:
    return np.array(value["array"], dtype=value["dtype"]) if value.keys() == {"dtype", "array"} else value
