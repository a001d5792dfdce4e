"""The kinds of files that are known, and the table of a file by the best evidence for one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.readers.binary_table import FEATHER, read_hdf5_table, read_parquet_table
from invid.recording.readers.file_kind import FileKind, FileStart, RefusedKind
from invid.recording.readers.lvm_table import LvmFile
from invid.recording.readers.mat_table import read_mat_table
from invid.recording.readers.mcap_table import read_mcap_table
from invid.recording.readers.mdf_table import read_mdf_table
from invid.recording.readers.packed_file import NumpyFile, PackedFile, SqliteFile, ZipArchive
from invid.recording.readers.serial_monitor import LabelledFile, SerialMonitorFile
from invid.recording.readers.tdms_table import read_tdms_table
from invid.recording.readers.text_table import read_text_table
from invid.recording.tables import Table, with_whole_stamps

READERS = "invid.readers"
"""Entry point group of further ``FileKind`` instances, from packages above the core, by their names."""


class _Columnar(FileKind):
    """Files of one library that say everything themselves."""

    def __init__(
        self, name: str, read: Callable[[Path], Table], starts: tuple[bytes, ...], *endings: str
    ) -> None:
        self.name, self._read, self.starts, self.endings = name, read, starts, endings

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns."""
        return self._read(path)


class MdfFile(_Columnar):
    """MDF 4: measured channels, or the raw frames of a bus, which are a CAN log."""

    def __init__(self) -> None:
        super().__init__("mdf", read_mdf_table, (b"MDF     ", b"UnFinMF "), ".mf4", ".mdf")

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns, or the PDOs of the frames."""
        table = self._read(path)
        if source.kind == self.name or not any(n.startswith("CAN_DataFrame") for n in table.columns):
            return table
        return _further("can_log")(path, source, beside=beside)


class TextFile(FileKind):
    """Delimited text: what nothing else is."""

    name = "csv"
    endings = (".csv", ".txt", ".tsv", ".dat", ".lvm", ".log")

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns."""
        return read_text_table(path, source)


def _can_log(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    return _further("can_log")(path, source, beside=beside)


def read_table(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """The columns of one file; its kind from the map, else by its first bytes, its head, its ending."""
    return with_whole_stamps(kind_of(path, source)(path, source, beside=beside))


def kind_of(path: Path, source: Source) -> FileKind:
    """The kind of a file: the map's, but what is packed is unpacked first."""
    start = FileStart.of(path)
    best = max((*_KINDS, *_all_further()), key=lambda k: k.evidence(start))
    if source.kind is not None and not isinstance(best, _PACKED):
        return next((k for k in _KINDS if k.name == source.kind), None) or _further(source.kind)
    return best if best.evidence(start) else _TEXT


@cache
def _further(name: str) -> FileKind:
    """The kind that a package above the core offers: the core knows no bus."""
    for point in entry_points(group=READERS, name=name):
        kind: FileKind = point.load()
        return kind
    raise InputError(
        f"no installed package reads files of the kind {name!r} (entry point group {READERS!r}); "
        "CAN logs are read by invid_drivers: install invid again"
    )


def _all_further() -> Iterator[FileKind]:
    return (_further(p.name) for p in entry_points(group=READERS))


_TEXT = TextFile()
_PACKED = (PackedFile, ZipArchive)
_KINDS: tuple[FileKind, ...] = (
    PackedFile(read_table),
    ZipArchive(read_table),
    NumpyFile(),
    SqliteFile(_can_log),
    _Columnar("hdf5", read_hdf5_table, (b"\x89HDF\r\n\x1a\n",), ".h5", ".hdf5", ".hdf"),
    _Columnar(
        "mat", read_mat_table, (b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT", b"\x89HDF\r\n\x1a\n"), ".mat"
    ),
    _Columnar("parquet", read_parquet_table, (b"PAR1", FEATHER), ".parquet", ".pq", ".feather"),
    _Columnar("mcap", read_mcap_table, (b"\x89MCAP0\r\n",), ".mcap"),
    _Columnar("tdms", read_tdms_table, (b"TDSm",), ".tdms"),
    MdfFile(),
    RefusedKind(
        "a ROS 1 bag",
        "convert it to MCAP (pip install rosbags; rosbags-convert --src run.bag --dst run --dst-storage "
        "mcap) and give the .mcap",
        starts=(b"#ROSBAG V",), endings=(".bag",),
    ),
    RefusedKind(
        "an old Excel workbook", "save the sheet as CSV", starts=(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",),
        endings=(".xls",),
    ),
    RefusedKind(
        "a PX4 log", "pip install pyulog; ulog2csv it and give the CSV of one topic",
        starts=(b"ULog\x01\x12\x35",), endings=(".ulg",),
    ),
    RefusedKind(
        "a TwinCAT Scope project", "export it there as CSV (Scope: Export, CSV), or with TC3ScopeExportTool",
        endings=(".svdx", ".tcscopex", ".svd"),
    ),
    RefusedKind(
        "a Python pickle", "it runs code as it is loaded; there, DataFrame.to_csv or np.savez it",
        starts=(b"\x80\x02", b"\x80\x03", b"\x80\x04\x95", b"\x80\x05\x95"), endings=(".pkl", ".pickle"),
    ),
    RefusedKind(
        "packed in a way that is not unpacked here", "unpack it and give the files",
        starts=(b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"\x04\x22\x4d\x18"),
        endings=(".zst", ".7z", ".rar", ".lz4"),
    ),
    RefusedKind("a PDF", "give the record itself", starts=(b"%PDF-",), endings=(".pdf",)),
    RefusedKind("a picture", "give the record itself", starts=(b"\x89PNG", b"\xff\xd8\xff", b"GIF8")),
    RefusedKind(
        # version https://git-lfs.github.com/spec/v1
        "a pointer of Git LFS, not the file itself", "'git lfs pull' it",
        header=r"\Aversion https://git-lfs\.github\.com/",
    ),
    RefusedKind(
        # <!DOCTYPE html>
        "a web page", "download the file itself ('raw')", header=r"(?i)\A\s*<(!doctype html|html)",
    ),
    RefusedKind(
        # {"time": [0, 0.001], "position": [0.1, 0.2]}
        "JSON", "write it as CSV (Python: pandas.read_json(file).to_csv('record.csv', index=False); "
        "lines=True where each line is an object)",
        header=r"\A\s*[\[{]\s*[\[{\"\]}]",
    ),
    LvmFile(),
    SerialMonitorFile(),
    LabelledFile(),
    _TEXT,
)  # fmt: skip
