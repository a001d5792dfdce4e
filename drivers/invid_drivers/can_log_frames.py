"""Frames of CAN logs in columns: text by rows of patterns through polars, captures by dpkt, the others by
python-can.

No kept library reads candump's screen, the CSV of SavvyCAN (GVRET), BUSMASTER's log and Kvaser's CanKing; the
pattern that tells a whole line of candump's log has read it.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import dpkt
import numpy as np
import polars as pl

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64, Int64
from invid.recording.readers.kinds import FileStart, first_line
from invid.recording.readers.text_rows import seconds_of
from invid.recording.tables import BrokenRow
from invid_drivers.can_log_kind import ASIDE, CAPTURES, LINES

MAX_FRAMES = 50_000_000
MAX_BROKEN = 100_000
_BATCH = 200_000
"""Lines that are taken apart at once."""
READ = (
    "candump (-L, or its screen with -t a, z, d, A), Vector ASC, SavvyCAN/GVRET CSV, BUSMASTER, CanKing, "
    "captures of "
    "Wireshark (pcap, pcapng), and BLF, PEAK TRC, MF4 of frames, and python-can's CSV and SQLite"
)
STARTS = {
    b"LOGG": can.BLFReader, b"MDF     ": can.MF4Reader, b"SQLite format 3": can.SqliteReader,
    b";$FILEVERSION": can.TRCReader, b"timestamp,arbitration_id,": can.CSVReader,
}  # fmt: skip
"""Readers of python-can by a file's first bytes, whatever its name."""
_ERROR = 0x20000000
"""Flag of an error frame in SocketCAN's identifier; the two above are extended and remote."""
_REMOTE = 0x40000000


@dataclass(frozen=True, eq=False)
class Frames:
    """Data frames of a log, n of them, in its order.

    Attributes
    ----------
    time
        (n,) stamps [s].
    elapsed
        (n,) [s] the stamps of everything that the log stamps, up to each frame, added up.
    identifier, length
        (n,) without flags; bytes of each.
    data
        (n, longest) bytes, zeros behind the last.
    channel
        (n,) place in ``channels``, the log's names of its buses.
    received
        (n,) False where the logger sent the frame itself.
    number
        (n,) of the line, in a binary log of the frame, from 1.
    """

    time: Float64
    elapsed: Float64
    identifier: Int64
    length: Int64
    data: np.typing.NDArray[np.uint8]
    channel: Int64
    channels: tuple[str, ...]
    received: Bool
    number: Int64
    broken: tuple[BrokenRow, ...]
    is_text: bool

    def where(self, rows: Bool) -> Frames:
        """The frames of a mask."""
        if rows.all():
            return self
        parts = ("time", "elapsed", "identifier", "length", "data", "channel", "received", "number")
        own = {name: getattr(self, name)[rows] for name in parts}
        return Frames(**own, channels=self.channels, broken=self.broken, is_text=self.is_text)

    def counts(self) -> dict[int, int]:
        """Identifier → frames, most first."""
        found, counts = np.unique(self.identifier, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return dict(zip(found[order].tolist(), counts[order].tolist(), strict=True))


def is_capture(head: bytes) -> bool:
    """Whether a file is a capture of Wireshark or tcpdump."""
    return head.startswith(CAPTURES)


def read_frames(path: Path) -> Frames:
    """The frames of a log.

    Raises
    ------
    InputError
        No frame of a kind known here.
    """
    start = FileStart.of(path)
    kind = None if start.head.startswith((*STARTS, *CAPTURES)) else _line_kind(start.text)
    try:
        frames = _text_frames(path, kind) if kind else _gathered(path, _messages(path, start))
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        raise InputError(
            f"{path}: cannot be read as a CAN log: {first_line(error)}; read are {READ}", code="unreadable"
        ) from None
    if not frames.time.size:
        raise InputError(
            f"{path}: no line of it is a CAN frame of a kind known here; read are {READ}", code="no_frames"
        )
    return frames


def _line_kind(head: str) -> str | None:
    lines = head.splitlines()[:50]
    return next(
        (kind for kind, pattern in LINES.items() if any(re.match(pattern, line) for line in lines)), None
    )


def _text_frames(path: Path, kind: str) -> Frames:
    lines = pl.scan_csv(
        path, has_header=False, separator="\x01", quote_char=None, schema={"line": pl.String},
        encoding="utf8-lossy", truncate_ragged_lines=True, glob=False,
    ).with_row_index("number", offset=1)  # fmt: skip
    parts = pl.col("line").str.strip_chars_end("\r").str.extract_groups(LINES[kind])
    base = 10 if kind == "busmaster" and "***DEC" in FileStart.of(path).text else 16
    # Texts of all lines at once take five times the file.
    batches = lines.with_columns(parts.alias("parts")).unnest("parts").collect_batches(chunk_size=_BATCH)
    channels: dict[str, int] = {}
    broken: list[BrokenRow] = []
    frames = [_batch_of_frames(batch, base, channels, path.name, broken) for batch in batches]
    longest = max((f.data.shape[1] for f in frames), default=1)
    data = np.zeros((sum(f.time.size for f in frames), longest), np.uint8)
    at = 0
    for f in frames:
        data[at : at + f.time.size, : f.data.shape[1]] = f.data
        at += f.time.size
    names = ("time", "elapsed", "identifier", "length", "channel", "received", "number")
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(f, name) for f in frames]) if frames else np.zeros(0, dtype=np.int64)
        for name in names
    }
    joined["elapsed"] = np.cumsum(joined["elapsed"])
    return Frames(**joined, data=data, channels=tuple(channels), broken=tuple(broken), is_text=True)


def _batch_of_frames(
    frame: pl.DataFrame, base: int, channels: dict[str, int], name: str, broken: list[BrokenRow]
) -> Frames:
    """The frames of some lines, with numbers to ``base``; ``elapsed`` are here the stamps themselves."""
    whole = frame["id"].is_not_null()
    wrong = frame.filter(~whole & ~frame["line"].fill_null("").str.contains(ASIDE))["number"]
    room = MAX_BROKEN - len(broken)
    broken += [BrokenRow(name, n, "no whole CAN frame") for n in wrong.head(room).to_list()]
    frame = frame.filter(whole)
    in_us = "us" in frame.columns
    time = frame["us"].cast(pl.Float64) / 1e6 if in_us else frame["t"].cast(pl.Float64, strict=False)
    if time.null_count() and (instants := seconds_of(frame["t"])) is not None:
        time = instants
    identifier = frame["id"].str.strip_prefix("0x").str.to_integer(base=base, dtype=pl.Int64).to_numpy()
    data, length = _bytes(frame["data"].fill_null(""), decimal=base == 10)
    for bus in frame["channel"].unique(maintain_order=True).to_list():
        channels.setdefault(bus, len(channels))
    stamps = time.to_numpy().astype(np.float64)
    stated = frame["length"].cast(pl.Int64).to_numpy() if "length" in frame.columns else length
    good = (identifier & _ERROR == 0) & ~frame["data"].str.starts_with("R").fill_null(False).to_numpy()
    frames = Frames(
        time=stamps,
        elapsed=stamps,
        identifier=(identifier & 0x1FFFFFFF).astype(np.int32),
        length=np.minimum(length, stated).astype(np.int32),
        data=data,
        channel=frame["channel"].replace_strict(channels, return_dtype=pl.Int32).to_numpy(),
        channels=(),
        received=(frame["way"].fill_null("R").str.to_uppercase() != "T").to_numpy(),
        number=frame["number"].to_numpy(),
        broken=(),
        is_text=True,
    )
    return frames.where(good & (length >= stated))


def _bytes(cells: pl.Series, *, decimal: bool) -> tuple[np.typing.NDArray[np.uint8], Int64]:
    """(n, longest) bytes and their numbers of cells that write them in hex, or in decimals."""
    if decimal:
        values = cells.str.extract_all(r"\d+").list.eval(pl.element().cast(pl.UInt8))
        length = values.list.len().to_numpy().astype(np.int64)
        columns = [
            values.list.get(i, null_on_oob=True).fill_null(0)
            for i in range(max(int(length.max(initial=0)), 1))
        ]
        return np.stack([c.to_numpy() for c in columns], axis=1), length
    if cells.str.contains(r"[\s,]").any():
        cells = cells.str.replace_all(r"\b([0-9A-Fa-f])\b", "0$1").str.replace_all(r"[\s,]+", "")
    cells = cells.str.replace(r"^R.*$", "")
    length = (cells.str.len_bytes() // 2).to_numpy().astype(np.int64)
    longest = max(int(length.max(initial=0)), 1)
    joined = cells.str.pad_end(2 * longest, "0").str.join("").item()
    return np.frombuffer(bytes.fromhex(joined), np.uint8).reshape(-1, longest), length


@dataclass
class _Gathered:
    """Frames as they come one by one: python-can's messages take fifty times their numbers."""

    time: array[float] = field(default_factory=lambda: array("d"))
    elapsed: array[float] = field(default_factory=lambda: array("d"))
    identifier: array[int] = field(default_factory=lambda: array("q"))
    length: array[int] = field(default_factory=lambda: array("q"))
    channel: array[int] = field(default_factory=lambda: array("q"))
    received: bytearray = field(default_factory=bytearray)
    number: array[int] = field(default_factory=lambda: array("q"))
    data: bytearray = field(default_factory=bytearray)


def _gathered(path: Path, messages: _Messages) -> Frames:
    got, channels, total, count = _Gathered(), dict[str, int](), 0.0, 0
    broken = messages.broken
    try:
        for count, m in enumerate(messages, 1):
            if count > MAX_FRAMES:
                raise InputError(f"{path}: more than {MAX_FRAMES} frames; cut the log", code="too_large")
            total += m.timestamp
            if m.is_error_frame or m.is_remote_frame:
                continue
            got.time.append(m.timestamp)
            got.elapsed.append(total)
            got.identifier.append(m.arbitration_id)
            got.length.append(len(m.data))
            got.channel.append(channels.setdefault(str(m.channel), len(channels)))
            got.received.append(m.is_rx)
            got.number.append(messages.line or count)
            got.data += m.data
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        if not got.time:
            raise
        # A log that was cut off while it was written still has all frames before the cut.
        broken.append(BrokenRow(path.name, count + 1, f"the log breaks off: {first_line(error)}"))
    length = np.array(got.length, dtype=np.int64)
    data = np.zeros((length.size, max(int(length.max(initial=0)), 1)), np.uint8)
    data[np.arange(data.shape[1]) < length[:, None]] = np.frombuffer(got.data, np.uint8)
    return Frames(
        np.array(got.time), np.array(got.elapsed), np.array(got.identifier, dtype=np.int64), length, data,
        np.array(got.channel, dtype=np.int64), tuple(channels), np.frombuffer(got.received, np.bool_).copy(),
        np.array(got.number, dtype=np.int64), tuple(broken), messages.line is not None,
    )  # fmt: skip


#    0.002100 1  181             Rx   d 8 37 12 FC FF FA FF FF FF
_ASC_FRAME = re.compile(r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\b")
#    0.002100 1  SYNC            Rx   d 0
_ASC_NAMED = re.compile(r"\s*\d+\.\d+\s+\d+\s+(?P<name>\S+)\s+[RT]x\s+d\s+[0-9A-Fa-f]\b")
_ASC_WHOLE = re.compile(
    r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\s+([0-9A-Fa-f])((\s+[0-9A-Fa-f]{1,3})*)(\s.*)?$"
)


@dataclass
class _Messages:
    """Messages of a log; of an ASC with the number of their ``line``, without lines that are no whole
    frame."""

    messages: Iterable[Any] = ()
    broken: list[BrokenRow] = field(default_factory=list)
    line: int | None = None

    def __iter__(self) -> Iterator[Any]:
        """The messages."""
        return iter(self.messages)

    def asc_lines(self, path: Path) -> Iterator[str]:
        """The lines of an ASC that python-can's reader can take."""
        with path.open(encoding="utf-8", errors="replace") as file:
            for self.line, line in enumerate(file, 1):
                if _ASC_FRAME.match(line):
                    whole = _ASC_WHOLE.match(line)
                    if not whole or len(whole[2].split()) < int(whole[1], 16):
                        self.broken.append(BrokenRow(path.name, self.line, "no whole CAN frame"))
                        continue
                elif (named := _ASC_NAMED.match(line)) is not None:
                    raise InputError(
                        f"{path}: line {self.line} names its frame {named['name']!r}: the log was written "
                        "with the "
                        "names of a database in place of identifiers",
                        way_out="export it again with identifiers ('symbolic' display off)",
                        code="named_frames",
                    )
                yield line


def _messages(path: Path, start: FileStart) -> _Messages:
    if is_capture(start.head):
        return _Messages(_captured(path))
    out = _Messages()
    reader = next((reader for first, reader in STARTS.items() if start.head.startswith(first)), None)
    if reader is None and (
        path.suffix.lower() in (".asc", ".log") or re.search(r"(?m)^\s*base\s+(hex|dec)\b", start.text)
    ):
        out.messages = can.ASCReader(_Lines(out.asc_lines(path)))  # type: ignore[arg-type]
    else:
        out.messages = reader(path) if reader is not None else can.LogReader(path)
    return out


class _Lines:
    """Lines as the file that python-can's reader asks for."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def __iter__(self) -> Iterator[str]:
        """The lines."""
        return self._lines

    def close(self) -> None:
        """Nothing: the generator closes its file."""


_SOCKETCAN, _COOKED, _COOKED_2 = 227, 113, 276
"""Link types of captures: frames themselves, and in Linux' cooked packets of several interfaces."""
_CAN_PROTOCOLS = (0x000C, 0x000D)


def _captured(path: Path) -> Iterator[can.Message]:
    """The frames of a capture of Wireshark, tcpdump or tshark (SocketCAN)."""
    with path.open("rb") as file:
        reader = dpkt.pcap.UniversalReader(file)
        link = reader.datalink()
        if link not in (_SOCKETCAN, _COOKED, _COOKED_2):
            raise InputError(
                f"{path}: is a capture of link type {link}, which holds no CAN frames",
                way_out="capture the CAN interface itself (tshark -i can0 -w log.pcapng), or export the CAN "
                "frames",
                code="no_frames",
            )
        for stamp, packet in reader:
            protocol, at, sent, channel = 0x000C, 0, False, "can0"
            if link == _COOKED:
                protocol, at, sent = int.from_bytes(packet[14:16], "big"), 16, packet[1] == 4
            elif link == _COOKED_2:
                protocol, at, sent = int.from_bytes(packet[:2], "big"), 20, packet[10] == 4
                channel = f"interface {int.from_bytes(packet[4:8], 'big')}"
            if protocol not in _CAN_PROTOCOLS or len(packet) < at + 8:
                continue
            word, size = int.from_bytes(packet[at : at + 4], "big"), packet[at + 4]
            yield can.Message(
                float(stamp), word & 0x1FFFFFFF, is_error_frame=bool(word & _ERROR),
                is_remote_frame=bool(word & _REMOTE), data=packet[at + 8 : at + 8 + size], channel=channel,
                is_rx=not sent, is_fd=size > 8,
            )  # fmt: skip
