"""CAN logs (candump .log, .asc, .blf) as tables: PDOs from a map or an EDS, one row per SYNC.

A row is one cycle: values that drives send in answer to SYNC k (TPDOs) stand in row k; a value the
master sends (RPDO) acts from the next SYNC on and stands in that row, held until the next one.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
from canopen.objectdictionary import import_od

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.import_map import Pdo, Signal, Source
from invid.recording.tables import BrokenRow, Table
from invid_drivers.can_log_guess import Guess, guess_pdos

MAX_FRAMES = 50_000_000
MAX_BROKEN = 100_000
_TEXT = (".log", ".asc")
_FORMATS = {
    "int8": ("b", 1), "uint8": ("B", 1), "int16": ("h", 2), "uint16": ("H", 2), "int32": ("i", 4),
    "uint32": ("I", 4), "int64": ("q", 8), "uint64": ("Q", 8), "float32": ("f", 4),
}  # fmt: skip
_EDS_TYPES = {
    1: "uint8",
    2: "int8",
    3: "int16",
    4: "int32",
    5: "uint8",
    6: "uint16",
    7: "uint32",
    8: "float32",
}


def read_can_log(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a log, named as in the map's PDOs; ``time`` is the SYNC instants [s] from the first one."""
    pdos = list(source.pdos)
    if source.eds is not None:
        pdos += _pdos_of_eds((beside or Path()) / source.eds, source.nodes)
    guessed = first_pdos(path, source.sync_id) if not pdos else None
    if guessed is not None:
        pdos = list(guessed.pdos)
    if not pdos:
        raise InputError(
            f"{path}: a CAN log needs 'pdos' (or 'eds' and 'nodes') in the map's 'source': which identifier "
            f"carries which objects; the log has identifiers {_identifiers(path)}"
        )
    layouts = {pdo.id: (pdo, _layout(pdo)) for pdo in pdos}
    names = [s.name for pdo in pdos for s in pdo.signals if s.type != "skip"]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: signal names in 'pdos' must differ, found {names}")
    if "time" in names:
        raise InputError(f"{path}: 'time' is the column of SYNC instants; give the signal another name")
    table = _rows(path, source, layouts, names)
    if guessed is None:
        return table
    said = {"pdos": [p.model_dump(exclude_none=True) for p in pdos], "reasons": list(guessed.reasons)}
    return replace(table, notes={**table.notes, **said})


def _rows(
    path: Path, source: Source, layouts: dict[int, tuple[Pdo, list[tuple[str, str, int]]]], names: list[str]
) -> Table:
    clock = source.sync_id if source.sync_id is not None else next(iter(layouts))
    column = {name: i for i, name in enumerate(names)}
    held = np.full(len(names), math.nan)
    row: Float64 | None = None
    instants: list[float] = []
    rows: list[Float64] = []
    short: list[BrokenRow] = []
    # Cut frames of a text log are found by line; of a binary log by the count of the frame.
    numbers: list[int] = []
    for number, frame in _frames(path, short):
        identifier = frame.arbitration_id
        if identifier == clock:
            row = np.full(len(names), math.nan)
            row[~np.isnan(held)] = held[~np.isnan(held)]
            instants.append(frame.timestamp)
            numbers.append(number)
            rows.append(row)
        if identifier not in layouts:
            continue
        pdo, layout = layouts[identifier]
        for name, code, offset in layout:
            if offset + struct.calcsize(code) > len(frame.data):
                short.append(
                    BrokenRow(path.name, number, f"frame 0x{identifier:X} has {len(frame.data)} bytes only")
                )
                break
            value = float(struct.unpack_from("<" + code, frame.data, offset)[0])
            if pdo.direction == "to_drive":
                held[column[name]] = value
            elif row is not None:
                row[column[name]] = value
    if len(instants) < 3:
        what = f"SYNC (0x{clock:X})" if source.sync_id is not None else f"frame 0x{clock:X}"
        raise InputError(
            f"{path}: {what} comes {len(instants)} times in the log; the map's 'sync_id' may be wrong (the "
            f"log has identifiers {_identifiers(path)}; null takes a sample at each frame of the first PDO)"
        )
    data = np.array(rows)
    # The log starts and stops in the middle of things: cycles that no drive has answered yet are no fault.
    whole = np.flatnonzero(np.isfinite(data).all(axis=1))
    if whole.size == 0:
        empty = [n for n in names if not np.isfinite(data[:, column[n]]).any()]
        raise InputError(
            f"{path}: no cycle carries every signal of the map; never seen: {empty or 'all at once'}; the "
            f"log has identifiers {_identifiers(path)}"
        )
    first, last = int(whole[0]), int(whole[-1]) + 1
    # Epoch stamps keep 0.2 µs in a float64: counted from the first SYNC they keep all the log has.
    time = (np.array(instants) - instants[first])[first:last]
    columns = {"time": time, **{n: data[first:last, i].copy() for n, i in column.items()}}
    return Table(
        name=str(path),
        columns=columns,
        lines=np.array(numbers[first:last], dtype=np.int64),
        line_word="line" if path.suffix.lower() in _TEXT else "frame",
        notes={"sync_id": clock},
        broken=tuple(short),
        units={"time": "s"},
    )


_CANDUMP = re.compile(
    r"\s*\(\d+(\.\d+)?\)\s+\S+\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(([0-9A-Fa-f]{2}){0,8}|R\d?|#[0-9A-Fa-f]([0-9A-Fa-f]{2}){0,64})(\s+[TRtr])?\s*$"
)
_CANDUMP_SHOWN = re.compile(
    r"\s*(\(\d+(?:\.\d+)?\))\s+(\S+)\s+(?:[TR]X\s+)?(?:-\s+)*([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"\s+\[(\d)\]((?:\s+[0-9A-Fa-f]{2})*)\s*(?:'.*)?$"
)
"""What candump shows on the screen with -t a, as people pipe it into a file."""
_ASC_FRAME = re.compile(r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\b")
_ASC_WHOLE = re.compile(
    r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\s+([0-9A-Fa-f])((\s+[0-9A-Fa-f]{1,3})*)(\s.*)?$"
)


class _Lines:
    """Lines of a text log for python-can's reader, without those that are broken: they are kept with
    their numbers."""

    def __init__(self, path: Path, broken: list[BrokenRow]) -> None:
        self._file = path.open(encoding="utf-8", errors="replace")
        self._name, self._asc, self._broken = path.name, path.suffix.lower() == ".asc", broken
        self.number = 0

    def __iter__(self) -> Iterator[str]:
        for line in self._file:
            self.number += 1
            whole = self._asc_line(line) if self._asc else self._candump_line(line)
            if whole is not None:
                yield whole
            elif len(self._broken) < MAX_BROKEN:
                self._broken.append(BrokenRow(self._name, self.number, "no whole CAN frame"))

    @staticmethod
    def _candump_line(line: str) -> str | None:
        if not line.strip() or line.lstrip().startswith("#"):
            return ""
        if _CANDUMP.match(line):
            return line
        shown = _CANDUMP_SHOWN.match(line)
        if shown is None:
            return None
        data = shown[5].split()
        return f"{shown[1]} {shown[2]} {shown[3]}#{''.join(data)}\n" if len(data) == int(shown[4]) else None

    @staticmethod
    def _asc_line(line: str) -> str | None:
        if not _ASC_FRAME.match(line):
            # Header, comments, events of other kinds: the reader knows which of them matter.
            return line
        whole = _ASC_WHOLE.match(line)
        return line if whole and len(whole[2].split()) >= int(whole[1], 16) else None

    def close(self) -> None:
        self._file.close()


def _reader(path: Path, lines: _Lines | None) -> Any:
    if lines is None:
        return can.LogReader(path)
    kind = can.ASCReader if path.suffix.lower() == ".asc" else can.CanutilsLogReader
    return kind(lines)  # type: ignore[arg-type]


def _frames(path: Path, broken: list[BrokenRow] | None = None) -> Iterator[tuple[int, Any]]:
    """Frames with the number of their line (in binary logs their own number, from 1)."""
    try:
        # A log truncated while it was written still has all frames before the cut.
        lines = _Lines(path, [] if broken is None else broken) if path.suffix.lower() in _TEXT else None
        with _reader(path, lines) as reader:
            for count, frame in enumerate(reader):
                if count >= MAX_FRAMES:
                    raise InputError(f"{path}: more than {MAX_FRAMES} frames; cut the log")
                if not (frame.is_error_frame or frame.is_remote_frame):
                    yield (count + 1 if lines is None else lines.number), frame
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        text = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise InputError(f"{path}: cannot be read as a CAN log: {text}") from None


def first_pdos(path: Path, sync_id: int | None) -> Guess:
    """What the frames of a log look like, where no map says what they carry."""
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


def _layout(pdo: Pdo) -> list[tuple[str, str, int]]:
    """Name, struct code and byte offset of each signal; whole bytes only."""
    bits = 0
    layout = []
    for signal in pdo.signals:
        if signal.type == "skip":
            bits += signal.bits or 8
            continue
        code, size = _FORMATS[signal.type]
        if bits % 8:
            raise InputError(f"map: PDO 0x{pdo.id:X}: {signal.name!r} starts at bit {bits}, not at a byte")
        layout.append((signal.name, code, bits // 8))
        bits += 8 * size
    if bits > 64:
        raise InputError(f"map: PDO 0x{pdo.id:X}: its signals take {bits} bits; a frame has 64")
    return layout


def _pdos_of_eds(path: Path, nodes: list[int]) -> list[Pdo]:
    """Default PDO mappings of an EDS, for each node; columns ``n<node>_<object in hex>``."""
    if not nodes:
        raise InputError("map: 'eds' needs 'nodes': the node numbers of the drives in the log")
    if not path.is_file():
        raise InputError(f"{path}: no such EDS file")
    found: list[Pdo] = []
    for node in nodes:
        try:
            dictionary = import_od(str(path), node_id=node)
        except Exception as error:  # configparser and canopen raise by kind of damage
            raise InputError(f"{path}: cannot be read as an EDS: {error}") from None
        for mapping, communication, direction, base in (
            (0x1A00, 0x1800, "from_drive", 0x180),
            (0x1600, 0x1400, "to_drive", 0x200),
        ):
            for k in range(4):
                signals = _mapped(dictionary, mapping + k, node)
                identifier = _default(dictionary, communication + k, 1)
                if signals and not (identifier or 0) & 0x80000000:
                    number = (identifier & 0x7FF) if identifier else base + 0x100 * k + node
                    found.append(
                        Pdo.model_validate({"id": number, "direction": direction, "signals": signals})
                    )
    if not found:
        raise InputError(f"{path}: maps no object into a PDO by default; give 'pdos' in the map instead")
    return found


def _default(dictionary: Any, index: int, sub: int) -> int | None:
    try:
        value = dictionary[index][sub].default
    except (KeyError, TypeError):
        return None
    return int(value) if isinstance(value, int) else None


def _mapped(dictionary: Any, index: int, node: int) -> list[Signal]:
    signals: list[Signal] = []
    for sub in range(1, (_default(dictionary, index, 0) or 0) + 1):
        entry = _default(dictionary, index, sub)
        if not entry:
            continue
        target, part, bits = entry >> 16, (entry >> 8) & 0xFF, entry & 0xFF
        kind = None
        try:
            variable = dictionary[target]
            variable = variable[part] if part and hasattr(variable, "subindices") else variable
            kind = _EDS_TYPES.get(variable.data_type)
        except (KeyError, AttributeError):
            pass
        name = f"n{node}_{target:04X}" + (f"_{part}" if part else "")
        if kind is None:
            signals.append(Signal(name=name, type="skip", bits=bits))
        else:
            signals.append(Signal.model_validate({"name": name, "type": kind}))
    return signals
