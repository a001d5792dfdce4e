"""Files that hold files: gzip, bzip2, xz, and ZIP of one; SQLite by its tables."""

from __future__ import annotations

import bz2
import gzip
import lzma
import sqlite3
import tempfile
import zipfile
import zlib
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from invid.errors import ChoiceNeeded, InputError
from invid.recording.import_map import Source
from invid.recording.readers.arrays import read_numpy
from invid.recording.readers.kinds import first_line, is_document, kind_named, read_table
from invid.recording.tables import Table

MAX_BYTES = 4_000_000_000
_DAMAGE = (
    OSError, EOFError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError, NotImplementedError,
)  # fmt: skip
_INSIDE = {
    "xl/": "an Excel workbook: save the sheet as CSV ('CSV UTF-8')",
    "content.xml": "an OpenDocument spreadsheet: save the sheet as CSV",
    "modelDescription.xml": "an FMU, a simulator and no record: give it to 'invid diagnose REC.h5 --against'",
    "simulink/": "a Simulink model, no record: log its signals and save them as MAT (structure with time)",
}
"""What else is a ZIP, by a name inside."""


def read_packed(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """The table of the one file that is packed."""
    with path.open("rb") as raw:
        head = raw.read(2)
    opened: Any = {b"\x1f\x8b": gzip.open, b"BZ": bz2.open}.get(head, lzma.open)
    name = path.stem if path.suffix.lower() in (".gz", ".bz2", ".xz") else path.name
    return _read_inside(path, name, opened(path, "rb"), source, beside)


def read_zip(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """The table of the one file inside; what else is a ZIP is refused by name."""
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if not n.endswith("/") and "__MACOSX" not in n]
        records = [n for n in names if not is_document(Path(n))]
        if names and all(n.endswith(".npy") for n in names):
            return read_numpy(path, source)
        for member, said in _INSIDE.items():
            if any(n == member or n.startswith(member) for n in names):
                raise InputError(f"{path}: is {said}", code="kind_not_read")
        if len(records) != 1:
            shown = ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
            raise InputError(
                f"{path}: is a ZIP archive of {len(names)} files ({shown})",
                way_out="unpack it and give the files or their folder",
                code="kind_not_read",
            )
        return _read_inside(path, Path(records[0]).name, archive.open(records[0]), source, beside)


def read_sqlite(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """The CAN log that python-can wrote, or the bag of ROS 2; InputError says of others how they are read."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        found = base.execute("select name from sqlite_master where type = 'table'").fetchall()
        tables = {str(n): {c[1] for c in base.execute(f"pragma table_info('{n}')")} for (n,) in found}
    if "arbitration_id" in tables.get("messages", set()):
        return kind_named("can_log")(path, source, beside=beside)
    if {"topics", "messages"} <= set(tables):
        return kind_named("bag")(path, source, beside=beside)
    raise InputError(
        f"{path}: is an SQLite database with the tables {', '.join(tables) or 'none'}, which is not read: "
        f"sqlite3 -header -csv {path.name} 'select * from TABLE' > record.csv",
        code="kind_not_read",
    )


def _read_inside(path: Path, name: str, opened: IO[bytes], source: Source, beside: Path | None) -> Table:
    """The table of the file inside, unpacked into a folder that goes with it."""
    with tempfile.TemporaryDirectory(prefix="invid-unpacked-") as folder:
        inside = Path(folder) / name
        try:
            with opened as packed, inside.open("wb") as out:
                while block := packed.read(1 << 20):
                    out.write(block)
                    if out.tell() > MAX_BYTES:
                        raise InputError(f"{path}: unpacks to more than {MAX_BYTES} bytes; unpack and cut it")
        except _DAMAGE as error:
            raise InputError(
                f"{path}: cannot be unpacked: {first_line(error)}; is it whole?", code="unreadable"
            ) from None
        try:
            table = read_table(inside, source, beside=beside)
        except InputError as error:
            error.reason = error.reason.replace(str(inside), f"{path} ({name} in it)")
            said = (
                ChoiceNeeded(error.reason, error.key, error.value)
                if isinstance(error, ChoiceNeeded)
                else InputError(error.reason, way_out=error.way_out, code=error.code)
            )
            raise said from None
    return replace(table, name=str(path), reasons=(f"{name} was unpacked", *table.reasons))
