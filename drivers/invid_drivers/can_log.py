"""CAN logs (candump .log, .asc, .blf) as tables: PDOs from a map or an EDS, one row per SYNC.

A row is one cycle: values that drives send in answer to SYNC k (TPDOs) stand in row k; a value the
master sends (RPDO) acts from the next SYNC on and stands in that row, held until the next one.
"""

from __future__ import annotations

import contextlib
import math
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import can
import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64
from invid.recording.import_map import Pdo, Source
from invid.recording.readers.file_kind import FileKind, FileStart
from invid.recording.tables import BrokenRow, Table
from invid_drivers.can_log_guess import SMOOTH, Guess, guess_pdos, roughness
from invid_drivers.can_log_lines import HEADER, READ, Lines, is_text_log
from invid_drivers.can_log_mapping import pdos_of_eds
from invid_drivers.can_log_traffic import CLOSE, TWICE, Choice, Traffic, choose

MAX_FRAMES = 50_000_000
ROUGH = 0.5
"""Mean square of a step over the variance from which a signal leaps: twice what counts as smooth."""
BOTH_DIFFER = 0.5
"""Share of pairs of rows with different numbers from which they are no frame and its echo."""
_TEXT = (".log", ".asc")
_FORMATS = {
    "int8": ("b", 1), "uint8": ("B", 1), "int16": ("h", 2), "uint16": ("H", 2), "int32": ("i", 4),
    "uint32": ("I", 4), "int64": ("q", 8), "uint64": ("Q", 8), "float32": ("f", 4), "float64": ("d", 8),
}  # fmt: skip
Layout: TypeAlias = list[tuple[str, struct.Struct, int]]


class CanLogFile(FileKind):
    """Logs of CAN frames, text or binary."""

    name = "can_log"
    endings = (".log", ".asc", ".blf", ".trc")
    starts = (b"LOGG", b"***BUSMASTER", b";$FILEVERSION")
    header = HEADER

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """See ``_read``."""
        return _read(path, source, beside)


read_can_log = CanLogFile()
"""The reader that the entry point names."""


def _read(path: Path, source: Source, beside: Path | None) -> Table:
    """Columns of a log, named as in the map's PDOs; ``time`` is the SYNC instants [s] from the first one."""
    pdos, remarks = list(source.pdos), tuple[str, ...]()
    if source.eds is not None:
        mapped, remarks = pdos_of_eds((beside or Path()) / source.eds, source.nodes)
        pdos += mapped
    guessed = first_pdos(path, source.sync_id) if not pdos else None
    if guessed is not None:
        pdos, source = list(guessed.pdos), source.model_copy(update={"sync_id": guessed.sync_id})
    if not pdos:
        raise InputError(
            f"{path}: a CAN log needs 'pdos' (or 'eds' and 'nodes') in the map's 'source': which identifier "
            f"carries which objects; the log has identifiers {_identifiers(path)}"
        )
    layouts = {pdo.id: (pdo, _layout(pdo, source.byte_order)) for pdo in pdos}
    names = [s.name for pdo in pdos for s in pdo.signals if s.type != "skip"]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: signal names in 'pdos' must differ, found {names}")
    if "time" in names:
        raise InputError(f"{path}: 'time' is the column of SYNC instants; give the signal another name")
    table = replace(_rows(path, source, layouts, names), remarks=remarks)
    if guessed is None:
        return table
    said = {"pdos": [p.model_dump(exclude_none=True) for p in pdos], "reasons": list(guessed.reasons)}
    return replace(table, notes={**table.notes, **said, "sync_id": guessed.sync_id})


@dataclass
class _Cycles:
    """Rows of a log as they grow: one a SYNC."""

    names: list[str]
    layouts: dict[int, tuple[Pdo, Layout]]
    clock: int
    file: str
    broken: list[BrokenRow] = field(default_factory=list)
    instants: array[float] = field(default_factory=lambda: array("d"))
    """Stamp of each SYNC."""
    elapsed: array[float] = field(default_factory=lambda: array("d"))
    """Stamps of all frames up to each SYNC, added up."""
    numbers: array[int] = field(default_factory=lambda: array("q"))
    """Line of each SYNC; in a binary log the count of the frame."""
    values: array[float] = field(default_factory=lambda: array("d"))
    """Of all rows, one after the other: a row of objects is ten times its numbers."""

    @property
    def rows(self) -> Float64:
        """Values so far, (n, signals)."""
        return np.array(self.values, dtype=np.float64).reshape(len(self.numbers), len(self.names))

    def read(self, path: Path, choice: Choice | None, *, once: float | None) -> Traffic:
        """Fill the rows from the frames that ``choice`` takes (None: all) and return what was there.

        ``once``: frames of one identifier with the same bytes nearer than this [s] are one.
        """
        traffic, total = Traffic(), 0.0
        watched = {self.clock, *self.layouts}
        column = {name: i for i, name in enumerate(self.names)}
        held = array("d", [math.nan] * len(self.names))
        last: dict[int, tuple[float, bytes]] = {}
        for number, frame in _frames(path, self.broken):
            total += frame.timestamp
            identifier = frame.arbitration_id
            if identifier not in watched:
                continue
            traffic.add(frame)
            if choice is not None and not choice.takes(frame):
                continue
            if once is not None:
                before, data = last.get(identifier, (-math.inf, b""))
                last[identifier] = frame.timestamp, bytes(frame.data)
                if frame.timestamp - before < once and data == frame.data:
                    continue
            if identifier == self.clock:
                self.instants.append(frame.timestamp)
                self.elapsed.append(total)
                self.numbers.append(number)
                self.values.extend(held)
            if identifier in self.layouts:
                self._take(frame, number, held, column)
        return traffic

    def _take(self, frame: Any, number: int, held: array[float], column: dict[str, int]) -> None:
        """Values of a PDO: what the master sends is held for the next row, a drive's are this row's."""
        pdo, layout = self.layouts[frame.arbitration_id]
        target = held if pdo.direction == "to_drive" else self.values
        row = 0 if target is held else len(self.values) - len(held)
        for name, form, offset in layout:
            if offset + form.size > len(frame.data):
                reason = f"frame 0x{frame.arbitration_id:X} has {len(frame.data)} bytes only"
                self.broken.append(BrokenRow(self.file, number, reason))
                return
            if row >= 0:
                target[row + column[name]] = form.unpack_from(frame.data, offset)[0]


def _read_cycles(path: Path, source: Source, cycles: _Cycles) -> _Cycles:
    """Rows of the frames that the map means; a log that holds others of the same number is read twice."""
    empty = _fresh(cycles)
    traffic = cycles.read(path, None, once=None)
    choice = choose(traffic, source, cycles.layouts, cycles.clock, path)
    d = np.diff(cycles.instants)
    mean = float(d.mean()) if d.size else 0.0
    if choice.leaves_out(traffic):
        cycles = empty
        cycles.read(path, choice, once=None)
    elif source.echo == "first":
        cycles = empty
        cycles.read(path, choice, once=CLOSE * mean)
    elif d.size > 8 and _in_pairs(d, mean) and not _pairs_differ(cycles.rows, d < CLOSE * mean):
        apart = 1e3 * float(np.median(np.sort(d)[: d.size // 2]))
        raise InputError(
            f"{path}: SYNC (0x{cycles.clock:X}) comes in pairs, {apart:.3g} ms apart: frames are logged "
            "twice, as sent and as heard; say 'echo: first' in the map's 'source' to read the first of each "
            "pair"
        )
    return cycles


def _pairs_differ(rows: Float64, close: Bool) -> bool:
    """Whether rows that are next to nothing apart hold numbers of their own: stamps are coarse, no echo."""
    first, second = rows[:-1][close], rows[1:][close]
    known = np.isfinite(first) & np.isfinite(second)
    return bool(np.mean((known & (first != second)).any(axis=1)) > BOTH_DIFFER)


def _in_pairs(apart: Float64, mean: float) -> bool:
    """Whether about half of the distances are next to nothing and the others twice the mean."""
    close = apart < CLOSE * mean
    return bool(mean > 0 and close.mean() > TWICE and abs(np.median(apart[~close]) / mean - 2.0) < 0.5)


def _fresh(cycles: _Cycles) -> _Cycles:
    return _Cycles(cycles.names, cycles.layouts, cycles.clock, cycles.file)


def _rows(path: Path, source: Source, layouts: dict[int, tuple[Pdo, Layout]], names: list[str]) -> Table:
    clock = source.sync_id if source.sync_id is not None else next(iter(layouts))
    cycles = _read_cycles(path, source, _Cycles(names, layouts, clock, path.name))
    if len(cycles.numbers) < 3:
        what = f"SYNC (0x{clock:X})" if source.sync_id is not None else f"frame 0x{clock:X}"
        raise InputError(
            f"{path}: {what} comes {len(cycles.numbers)} times in the log; the map's 'sync_id' may be wrong "
            f"(the log has identifiers {_identifiers(path)}; null takes a sample at each frame of the first "
            f"PDO)"
        )
    data = cycles.rows
    # The log starts and stops in the middle of things: cycles that no drive has answered yet are no fault.
    whole = np.flatnonzero(np.isfinite(data).all(axis=1))
    if whole.size == 0:
        empty = [n for i, n in enumerate(names) if not np.isfinite(data[:, i]).any()]
        raise InputError(
            f"{path}: no cycle carries every signal of the map; never seen: {empty or 'all at once'}; the "
            f"log has identifiers {_identifiers(path)}"
        )
    first, last = int(whole[0]), int(whole[-1]) + 1
    # Epoch stamps keep 0.2 µs in a float64: counted from the first SYNC they keep all the log has.
    instants = np.array(cycles.instants, dtype=np.float64)
    columns = {"time": (instants - instants[first])[first:last]}
    columns |= {n: data[first:last, i].copy() for i, n in enumerate(names)}
    _refuse_wrong_bytes(columns, layouts, path)
    return Table(
        name=str(path),
        columns=columns,
        lines=np.array(cycles.numbers[first:last], dtype=np.int64),
        line_word="line" if _is_text(path) else "frame",
        notes={"sync_id": clock},
        broken=tuple(cycles.broken),
        units={"time": "s"},
        sums={"time": np.array(cycles.elapsed[first:last], dtype=np.float64)},
    )


def _refuse_wrong_bytes(
    columns: dict[str, Float64], layouts: dict[int, tuple[Pdo, Layout]], path: Path
) -> None:
    """InputError where a signal leaps as it is read and moves smoothly with its bytes the other way round."""
    for pdo, layout in layouts.values():
        told = {s.name for s in pdo.signals if s.byte_order is not None}
        for name, form, _ in layout:
            if name in told:
                continue
            values = columns[name][np.isfinite(columns[name])]
            kind = np.dtype(form.format)
            if kind.kind == "f" or kind.itemsize == 1 or not roughness(values) > ROUGH:
                continue
            if roughness(values.astype(kind).byteswap().astype(float)) < SMOOTH:
                now = "big" if form.format.startswith(">") else "little"
                other = "little" if now == "big" else "big"
                raise InputError(
                    f"{path}: {name!r} leaps from row to row read as {now}-endian, and moves smoothly with "
                    f"its bytes the other way round; say 'byte_order: {other}' beside its 'type' (or for all "
                    f"in the map's 'source'), 'byte_order: {now}' there if it leaps indeed"
                )


_BY_START: dict[bytes, Any] = {
    b"LOGG": can.BLFReader, b"MDF     ": can.MF4Reader, b"SQLite format 3": can.SqliteReader,
    b";$FILEVERSION": can.TRCReader, b"timestamp,arbitration_id,": can.CSVReader,
}  # fmt: skip
"""Readers of python-can by a file's first bytes, whatever its name."""


def _reader(path: Path, lines: Lines | None) -> Any:
    if lines is not None:
        return can.ASCReader(lines) if lines.is_asc else contextlib.closing(lines)  # type: ignore[arg-type]
    with path.open("rb") as raw:
        head = raw.read(64)
    own = next((reader for start, reader in _BY_START.items() if head.startswith(start)), can.LogReader)
    return own(path)


def _is_text(path: Path) -> bool:
    """Whether a log is text, which ``Lines`` reads; python-can's readers take the others."""
    start = FileStart.of(path)
    if start.head.startswith(tuple(_BY_START)):
        return False
    return path.suffix.lower() in _TEXT or is_text_log(start.text)


def _frames(path: Path, broken: list[BrokenRow] | None = None) -> Iterator[tuple[int, Any]]:
    """Frames with the number of their line (in binary logs their own number, from 1)."""
    seen, counted = 0, [] if broken is None else broken
    try:
        # A log truncated while it was written still has all frames before the cut.
        lines = Lines(path, counted) if _is_text(path) else None
        with _reader(path, lines) as reader:
            for count, frame in enumerate(reader):
                if count >= MAX_FRAMES:
                    raise InputError(f"{path}: more than {MAX_FRAMES} frames; cut the log")
                if not (frame.is_error_frame or frame.is_remote_frame):
                    seen += 1
                    yield (count + 1 if lines is None else lines.number), frame
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        text = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise InputError(f"{path}: cannot be read as a CAN log: {text}; read are {READ}") from None
    if seen == 0:
        raise InputError(f"{path}: no line of it is a CAN frame of a kind known here; read are {READ}")


def first_pdos(path: Path, sync_id: int | None) -> Guess:
    """PDOs guessed from the frames of a log, where no map says what they carry."""
    return guess_pdos(_payloads(path), sync_id)


def _payloads(path: Path) -> dict[int, list[bytes]]:
    """The first frames of a log by identifier."""
    seen: dict[int, list[bytes]] = {}
    for count, (_, frame) in enumerate(_frames(path)):
        if count > 20_000:
            break
        seen.setdefault(frame.arbitration_id, []).append(bytes(frame.data))
    return seen


def _identifiers(path: Path) -> str:
    seen = _payloads(path)
    most = sorted(seen, key=lambda i: -len(seen[i]))[:12]
    return ", ".join(f"0x{i:X}" for i in sorted(most)) or "none"


def _layout(pdo: Pdo, byte_order: str | None) -> Layout:
    """Name, form and byte offset of each signal; whole bytes only."""
    bits = 0
    layout = []
    for signal in pdo.signals:
        if signal.type == "skip":
            bits += signal.bits or 8
            continue
        code, size = _FORMATS[signal.type]
        if bits % 8:
            raise InputError(f"map: PDO 0x{pdo.id:X}: {signal.name!r} starts at bit {bits}, not at a byte")
        order = signal.byte_order or byte_order
        form = struct.Struct((">" if order == "big" else "<") + code)
        layout.append((signal.name, form, bits // 8))
        bits += 8 * size
    if bits > 512:
        raise InputError(f"map: PDO 0x{pdo.id:X}: its signals take {bits} bits; a frame of CAN FD has 512")
    return layout
