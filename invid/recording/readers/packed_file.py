"""Files that hold files: gzip, bzip2, xz, and ZIP of one; NumPy's archive of arrays; SQLite by its tables."""

from __future__ import annotations

import bz2
import gzip
import lzma
import sqlite3
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from invid.errors import ChoiceNeeded, InputError
from invid.recording.import_map import Source
from invid.recording.readers.binary_table import MAX_VALUES, channels, finish, first_line
from invid.recording.readers.file_kind import FileKind, is_document
from invid.recording.tables import Table

MAX_BYTES = 4_000_000_000
_DAMAGE = (
    OSError, EOFError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError, NotImplementedError,
)  # fmt: skip
Reader = Callable[..., Table]


class PackedFile(FileKind):
    """One file, packed: read as what it is unpacked."""

    name = "packed file"
    starts = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00")
    endings = (".gz", ".bz2", ".xz")

    def __init__(self, read: Reader) -> None:
        self._read = read

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The table of the file inside."""
        head = path.open("rb").read(2)
        opened: Any = {b"\x1f\x8b": gzip.open, b"BZ": bz2.open}.get(head, lzma.open)
        name = path.stem if path.suffix.lower() in self.endings else path.name
        with _unpacked(path, name, lambda: opened(path, "rb")) as inside:
            return _as_of(path, inside, self._read, source, beside)


class ZipArchive(FileKind):
    """ZIP of one file, read as that; what else is a ZIP is refused by name."""

    name = "ZIP archive"
    starts = (b"PK\x03\x04",)
    endings = (".zip",)

    def __init__(self, read: Reader) -> None:
        self._read = read

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The table of the one file inside."""
        try:
            archive = zipfile.ZipFile(path)
            names = [n for n in archive.namelist() if not n.endswith("/") and "__MACOSX" not in n]
            records = [n for n in names if not is_document(Path(n))]
        except _DAMAGE as error:
            raise InputError(f"{path}: cannot be read as a ZIP archive: {first_line(error)}") from None
        with archive:
            if names and all(n.endswith(".npy") for n in names):
                return _arrays(path)
            for member, said in _INSIDE.items():
                if any(n == member or n.startswith(member) for n in names):
                    raise InputError(f"{path}: is {said}")
            if len(records) != 1:
                shown = ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
                raise InputError(
                    f"{path}: is a ZIP archive of {len(names)} files ({shown}): unpack it and give the files "
                    "or their folder"
                )
            with _unpacked(path, Path(records[0]).name, lambda: archive.open(records[0])) as inside:
                return _as_of(path, inside, self._read, source, beside)


_INSIDE = {
    "xl/": "an Excel workbook: save the sheet as CSV ('CSV UTF-8')",
    "content.xml": "an OpenDocument spreadsheet: save the sheet as CSV",
    "modelDescription.xml": "an FMU, a simulator and no record: give it to 'invid diagnose REC.h5 --against'",
    "simulink/": "a Simulink model, no record: log its signals and save them as MAT (structure with time)",
}
"""What else is a ZIP, by a name inside."""


class NumpyFile(FileKind):
    """One array of NumPy's."""

    name = "npy"
    starts = (b"\x93NUMPY",)
    endings = (".npy",)

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """Columns of the array, or of its fields."""
        return _arrays(path)


def _arrays(path: Path) -> Table:
    try:
        loaded = np.load(path, allow_pickle=False)
        named = loaded if isinstance(loaded, np.lib.npyio.NpzFile) else {path.stem: loaded}
        columns: dict[str, Any] = {}
        for name in named:
            array = named[name]
            if array.size > MAX_VALUES:
                raise InputError(f"{path}: {name!r} holds more numbers than this program reads from one file")
            columns |= channels(name, array)
    except InputError:
        raise
    except (*_DAMAGE, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read as NumPy's arrays: {first_line(error)} (objects are not read: save "
            "plain arrays, np.savez(file, position=…, torque=…))"
        ) from None
    return finish(path, columns, {})


class SqliteFile(FileKind):
    """An SQLite database: python-can's is a CAN log, the others are refused by what their tables are."""

    name = "SQLite database"
    starts = (b"SQLite format 3\x00",)
    endings = (".db3", ".db", ".sqlite", ".sqlite3")

    def __init__(self, can_log: Reader) -> None:
        self._can_log = can_log

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The CAN log; InputError says of others how they become a file that is read."""
        try:
            with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
                found = base.execute("select name from sqlite_master where type = 'table'").fetchall()
                tables = {str(n): {c[1] for c in base.execute(f"pragma table_info('{n}')")} for (n,) in found}
        except sqlite3.Error as error:
            raise InputError(f"{path}: cannot be read as an SQLite database: {error}") from None
        if "arbitration_id" in tables.get("messages", set()):
            return self._can_log(path, source, beside=beside)
        if {"topics", "messages"} <= set(tables):
            raise InputError(
                f"{path}: is a ROS 2 bag in SQLite, which is not read: 'ros2 bag convert' it to MCAP "
                "(output_bags: [{uri: out, storage_id: mcap, all_topics: true}]) and give the .mcap"
            )
        raise InputError(
            f"{path}: is an SQLite database with the tables {', '.join(tables) or 'none'}, which is not "
            f"read: sqlite3 -header -csv {path.name} 'select * from TABLE' > record.csv"
        )


@contextmanager
def _unpacked(path: Path, name: str, opened: Callable[[], IO[bytes]]) -> Iterator[Path]:
    """Context manager with the file inside, in a folder that goes with it."""
    with tempfile.TemporaryDirectory(prefix="invid-unpacked-") as folder:
        inside = Path(folder) / name
        try:
            with opened() as packed, inside.open("wb") as out:
                while block := packed.read(1 << 20):
                    out.write(block)
                    if out.tell() > MAX_BYTES:
                        raise InputError(f"{path}: unpacks to more than {MAX_BYTES} bytes; unpack and cut it")
        except _DAMAGE as error:
            raise InputError(f"{path}: cannot be unpacked: {first_line(error)}; is it whole?") from None
        yield inside


def _as_of(path: Path, inside: Path, read: Reader, source: Source, beside: Path | None) -> Table:
    try:
        table = read(inside, source, beside=beside)
    except ChoiceNeeded as error:
        raise ChoiceNeeded(_renamed(str(error), inside, path), error.key, error.value) from None
    except InputError as error:
        raise InputError(_renamed(str(error), inside, path)) from None
    return replace(table, name=str(path), reasons=(f"{inside.name} was unpacked", *table.reasons))


def _renamed(said: str, inside: Path, path: Path) -> str:
    return said.replace(str(inside), f"{path} ({inside.name} in it)")
