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

import numpy as np
import numpy.typing as npt

from invid.errors import RecordingError
from invid.recording.model import Outcome
from invid.recording.stored import StoredExperiment, StoredRecording

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
            os.fdatasync(self._file)
            sync_folder(target.parent)
        except OSError:
            self.close()
            with contextlib.suppress(OSError):
                self.path.unlink()
            raise

    def begin(self, key: str, names: Sequence[str], attributes: Mapping[str, Any]) -> None:
        """Begin an experiment; ``names`` of its datasets, in the order in which rows bring them."""
        self._frame(_BEGIN, _json({"key": key, "names": list(names), "attributes": dict(attributes)}))

    def rows(self, columns: Sequence[npt.NDArray[Any]]) -> None:
        """Append rows of every dataset of the experiment, (k,) or (k, M)."""
        parts = [np.ascontiguousarray(c, c.dtype.newbyteorder("<")).tobytes() for c in columns]
        self._frame(_ROWS, _COUNT.pack(columns[0].shape[0]) + b"".join(parts))
        first, last = float(columns[0][0]), float(columns[0][-1])
        self._synced_s = first if self._synced_s is None else self._synced_s
        if abs(last - self._synced_s) >= _SYNC_S:
            os.fdatasync(self._file)
            self._synced_s = last

    def end(self) -> None:
        """End the experiment."""
        self._frame(_END, b"")
        os.fdatasync(self._file)

    def outcome(self, outcome: str) -> None:
        """Write how the measurement ended."""
        self._frame(_OUTCOME, _json(outcome))

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

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


def read_spool(path: Path) -> StoredRecording:
    """The rows of a file; those that nobody ended are marked "failed".

    Raises
    ------
    RecordingError
        Where not even the header is whole.
    """
    header, begun, axes = dict[str, Any](), dict[str, Any](), 0
    blocks: dict[str, list[dict[str, npt.NDArray[Any]]]] = {}
    attributes: dict[str, Any] = {}
    for kind, content in _frames(path):
        if kind == _HEADER:
            header = {**_parsed(content), "outcome": str(Outcome.FAILED)}
            axes = len(json.loads(header["axes"]))
        elif kind == _BEGIN:
            begun = _parsed(content)
        elif kind == _OUTCOME:
            header["outcome"] = _parsed(content)
        elif kind == _ROWS and begun:  # an experiment without rows leaves no empty shell
            attributes[begun["key"]] = begun["attributes"]
            blocks.setdefault(begun["key"], []).append(_block(content, begun["names"], axes))
    if not header:
        raise RecordingError(f"{path}: was cut off before its header was whole; it holds no measurement")
    experiments = {
        key: StoredExperiment(attributes[key], {n: np.concatenate([b[n] for b in own]) for n in own[0]})
        for key, own in blocks.items()
    }
    return StoredRecording(header, experiments)


def _block(content: bytes, names: Sequence[str], axes: int) -> dict[str, npt.NDArray[Any]]:
    """The datasets of a frame of rows, (k,) or (k, M)."""
    (count,), at, found = _COUNT.unpack_from(content), _COUNT.size, {}
    for name in names:
        shape = (count,) if name == "time" else (count, axes)
        kind = np.dtype("<u2") if name == "status" else np.dtype("<f8")
        values = np.frombuffer(content, kind, int(np.prod(shape)), at).reshape(shape)
        found[name] = values.astype(kind.newbyteorder("="), copy=False)
        at += values.nbytes
    return found


def _frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield whole frames, to the first that is not."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        while len(head := file.read(_FRAME.size)) == _FRAME.size:
            kind, length, check = _FRAME.unpack(head)
            content = file.read(length) if length <= _LARGEST else b""
            if len(content) < length or zlib.crc32(content) != check:
                return
            yield kind, content


def _json(value: Any) -> bytes:
    try:
        return json.dumps(value, ensure_ascii=False, default=_plain).encode()
    except (TypeError, ValueError) as error:
        raise RecordingError(f"an attribute cannot be stored: {error}") from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "iufb":
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no number, text or array of numbers")


def _parsed(content: bytes) -> Any:
    # Releases up to 0.2 wrote arrays as objects.
    return json.loads(content, object_hook=lambda found: found.get("array", found))
