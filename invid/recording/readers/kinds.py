"""What a file is: kinds as rows of data, each recognised by its bytes and read by one library, or refused."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from invid.errors import InputError
from invid.extensions import extension_names, load_extension
from invid.recording.import_map import Source
from invid.recording.tables import Table, with_whole_stamps

HEAD = 8192
"""Bytes of a file that a kind is recognised by."""
READERS = "invid.readers"
"""Entry point group of further ``FileKind`` instances, from packages above the core, by their names."""


@dataclass(frozen=True)
class FileKind:
    """A kind of file; its evidence: first bytes before a line of the head before the name's ending."""

    name: str
    """As a map's ``source.kind`` names it, or as a refusal does."""
    reader: str = ""
    """``module:function`` of ``(path, source, *, beside) -> Table``; its library is loaded with it."""
    starts: tuple[bytes, ...] = ()
    endings: tuple[str, ...] = ()
    header: str = ""
    """Pattern that is found in the first lines of its text files."""
    way: str = ""
    """Of a kind that is not read: the way to one that is."""
    packages: str = ""
    """The extra of this distribution that brings the library."""
    holds_another: bool = False
    """Whether the kind a map states is that of the file inside."""

    def evidence(self, start: FileStart) -> int:
        """6 for first bytes, 4 for a line of the head, one more where the ending agrees; 0: none."""
        ending = start.path.suffix.lower() in self.endings
        if self.starts and start.head.startswith(self.starts):
            return 6 + ending
        if self.header and re.search(self.header, start.text, re.MULTILINE):
            return 4 + ending
        return int(ending)

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns of a file; ``beside`` is the map's folder.

        Raises
        ------
        InputError
            A file that is damaged, or of a kind that is not read: with the way to one that is.
        """
        if self.way:
            raise InputError(f"{path}: is {self.name}, which is not read: {self.way}", code="kind_not_read")
        module, function = self.reader.split(":")
        try:
            table: Table = getattr(import_module(module), function)(path, source, beside=beside)
        except (InputError, MemoryError):
            raise
        except ModuleNotFoundError as error:
            raise InputError(
                f"{path}: {self.name} needs the package {error.name}",
                way_out="install it with pip install "
                + (f"'invid[{self.packages}]'" if self.packages else "invid, again"),
                code="package_missing",
            ) from None
        except Exception as error:  # libraries raise by kind of damage: ValueError, struct.error, KeyError, …
            raise InputError(
                f"{path}: cannot be read as {self.name}: {first_line(error)}; is it whole?", code="unreadable"
            ) from None
        return table


@dataclass(frozen=True)
class FileStart:
    """What tells the kind of a file: its name and its first bytes."""

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> FileStart:
        """The start of a file; InputError where it is empty or cannot be read."""
        try:
            with path.open("rb") as raw:
                head = raw.read(HEAD)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read: {error.strerror or error}", code="unreadable"
            ) from None
        if not head:
            raise InputError(f"{path}: the file is empty", code="no_data")
        return cls(path, head)

    @property
    def text(self) -> str:
        """The first lines; nothing of a binary file."""
        return "" if b"\0" in self.head else self.head.decode("utf-8-sig", "replace")


def first_line(error: BaseException) -> str:
    """What an error of a library says first, for a message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]


def is_document(path: Path) -> bool:
    """Whether a file is about the records, or a program, and none of them: by its name."""
    return bool(_DOCUMENT.search(path.name))


_DOCUMENT = re.compile(
    # README.txt, LICENSE, notes.md, plot_results.m, robot.urdf, config.yaml, photo.jpg, .DS_Store
    r"^(readme|licen[cs]e|changelog|notes?|citation|authors|makefile)(\.\w+)?$|^\.|"
    r"\.(md|rst|pdf|docx?|pptx?|html?|tex|bib|png|jpe?g|svg|gif|mp4|py|m|mlx|ipynb|sh|bat|ps1|c|cpp|h|"
    r"ya?ml|json|toml|ini|cfg|xml|urdf|xacro|dbc|eds|dcf|pyc|license)$",
    re.IGNORECASE,
)


def read_table(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """The columns of one file; its kind from the map, else by its first bytes, its head, its ending."""
    return with_whole_stamps(kind_of(path, source)(path, source, beside=beside))


def kind_of(path: Path, source: Source) -> FileKind:
    """The kind of a file: the map's, but what is packed is unpacked first."""
    start = FileStart.of(path)
    best = max((*KINDS, *_all_further()), key=lambda k: k.evidence(start))
    if source.kind is not None and not best.holds_another:
        return kind_named(source.kind)
    return best if best.evidence(start) else KINDS[-1]


def kind_named(name: str) -> FileKind:
    """The kind of this name, here or in a package above the core."""
    return next((k for k in KINDS if k.name == name), None) or further_kind(name)


@cache
def further_kind(name: str) -> FileKind:
    """The kind that a package above the core offers: the core knows no bus."""
    kind: FileKind | None = load_extension(READERS, name)
    if kind is None:
        here = [k.name for k in KINDS if k.reader and " " not in k.name]
        raise InputError(
            f"source.kind: no installed package reads files of the kind {name!r}",
            way_out=f"there are {', '.join([*here, *extension_names(READERS)])}; a further one is offered in "
            f"the entry point group {READERS!r}",
            code="unknown_kind",
        )
    return kind


def _all_further() -> Iterator[FileKind]:
    return map(further_kind, extension_names(READERS))


def _refused(
    what: str, way: str, *starts: bytes, endings: tuple[str, ...] = (), header: str = ""
) -> FileKind:
    return FileKind(what, starts=starts, endings=endings, header=header, way=way)


_HDF5 = b"\x89HDF\r\n\x1a\n"
_HERE = "invid.recording.readers"
KINDS: tuple[FileKind, ...] = (
    FileKind(
        "packed file", f"{_HERE}.packed_file:read_packed", (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00"),
        (".gz", ".bz2", ".xz"), holds_another=True,
    ),
    FileKind("ZIP archive", f"{_HERE}.packed_file:read_zip", (b"PK\x03\x04",), (".zip",), holds_another=True),
    FileKind("npy", f"{_HERE}.arrays:read_numpy", (b"\x93NUMPY",), (".npy", ".npz")),
    FileKind(
        "SQLite database", f"{_HERE}.packed_file:read_sqlite", (b"SQLite format 3\x00",),
        (".db3", ".db", ".sqlite", ".sqlite3"),
    ),
    FileKind("hdf5", f"{_HERE}.arrays:read_hdf5", (_HDF5,), (".h5", ".hdf5", ".hdf")),
    FileKind("mat", f"{_HERE}.mat_table:read_mat", (b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT", _HDF5), (".mat",)),
    FileKind(
        "parquet", f"{_HERE}.arrays:read_parquet", (b"PAR1", b"ARROW1"), (".parquet", ".pq", ".feather"),
    ),
    FileKind("mcap", f"{_HERE}.mcap_table:read_mcap", (b"\x89MCAP0\r\n",), (".mcap",), packages="mcap"),
    FileKind("bag", f"{_HERE}.mcap_table:read_bag", (b"#ROSBAG V2.0",), (".bag",), packages="mcap"),
    FileKind("tdms", f"{_HERE}.tdms_table:read_tdms", (b"TDSm",), (".tdms",), packages="tdms"),
    FileKind(
        "mdf", f"{_HERE}.mdf_table:read_mdf", (b"MDF     ", b"UnFinMF "), (".mf4", ".mdf"), packages="mdf"
    ),
    _refused(
        "an old Excel workbook", "save the sheet as CSV", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
        endings=(".xls",),
    ),
    _refused(
        "a PX4 log", "pip install pyulog; ulog2csv it and give the CSV of one topic", b"ULog\x01\x12\x35",
        endings=(".ulg",),
    ),
    _refused(
        "a WPILib log",
        "open it in AdvantageScope and export it as CSV (File, Export Data: CSV table) or as MCAP", b"WPILOG",
        endings=(".wpilog",),
    ),
    _refused(
        "a log of CTRE Phoenix (hoot)", "owlet FILE.hoot -f wpilog, then AdvantageScope's export as CSV",
        endings=(".hoot",),
    ),
    _refused(
        "a REV log", "convert it with AdvantageScope and export it as CSV", endings=(".revlog",),
    ),
    _refused(
        "a log of ArduPilot",
        "mavlogdump.py --format csv --types … FILE > record.csv (pip install pymavlink)", b"\xa3\x95\x80\x80",
    ),
    _refused(
        "a recording of Rerun", "query it there as a table: rerun.dataframe to Parquet or CSV", b"RRF2",
        endings=(".rrd",),
    ),
    _refused(
        "a TwinCAT Scope project", "export it there as CSV (Scope: Export, CSV), or with TC3ScopeExportTool",
        endings=(".svdx", ".tcscopex", ".svd"),
    ),
    _refused(
        "a Python pickle", "it runs code as it is loaded; there, DataFrame.to_csv or np.savez it",
        b"\x80\x02", b"\x80\x03", b"\x80\x04\x95", b"\x80\x05\x95", endings=(".pkl", ".pickle"),
    ),
    _refused(
        "packed in a way that is not unpacked here", "unpack it and give the files",
        b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"\x04\x22\x4d\x18",
        endings=(".zst", ".7z", ".rar", ".lz4"),
    ),
    _refused("a PDF", "give the record itself", b"%PDF-", endings=(".pdf",)),
    _refused("a picture", "give the record itself", b"\x89PNG", b"\xff\xd8\xff", b"GIF8"),
    _refused(
        "a pointer of Git LFS, not the file itself", "'git lfs pull' it",
        header=r"\Aversion https://git-lfs\.github\.com/",
    ),
    _refused("a web page", "download the file itself ('raw')", header=r"(?i)\A\s*<(!doctype html|html)"),
    _refused(
        "JSON", "write it as CSV (Python: pandas.read_json(file).to_csv('record.csv', index=False); "
        "lines=True where each line is an object)",
        header=r"\A\s*[\[{]\s*[\[{\"\]}]",
    ),
    FileKind(
        "csv", f"{_HERE}.text_table:read_text", endings=(".csv", ".txt", ".tsv", ".dat", ".lvm", ".log")
    ),
)  # fmt: skip
"""Text is what nothing else is: the last."""


def limit_numbers(claimed: Mapping[str, int], path: Path, most: int = 200_000_000) -> None:
    """InputError where arrays by name claim more numbers than this program reads."""
    total = 0
    for name, count in claimed.items():
        total += count
        if total > most:
            raise InputError(
                f"{path}: {name!r} claims {count} numbers, more than this program reads", code="too_large"
            )


__all__ = [
    "KINDS",
    "FileKind",
    "FileStart",
    "first_line",
    "is_document",
    "kind_named",
    "kind_of",
    "limit_numbers",
    "read_table",
]
