"""Frames of CAN logs in columns: text by rows of patterns through polars, captures by dpkt, the others by
python-can.

No kept library reads candump's screen, the CSV of SavvyCAN (GVRET), BUSMASTER's log and Kvaser's CanKing; the
pattern that tells a whole line of candump's log has read it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib import reload
from pathlib import Path
from typing import Any

import can
import dpkt
import numpy as np
import polars as pl
from can.io import mf4

from invid.errors import InputError
from invid.numerics.arrays import Bool
from invid.recording.readers.kinds import FileStart, first_line
from invid.recording.readers.text_rows import seconds_of
from invid.recording.tables import BrokenRow
from invid_drivers.can_log.kind import ASC_FRAME, ASIDE, CAPTURES, LINES, NAMED

MAX_FRAMES = 50_000_000
MAX_BROKEN = 100_000
_BATCH = 200_000
"""Frames that are gathered before they become a table."""
READ = (
    "candump (-L, or its screen with -t a, z, d, A), Vector ASC, SavvyCAN/GVRET CSV, BUSMASTER, CanKing, "
    "captures of "
    "Wireshark (pcap, pcapng), and BLF, PEAK TRC, MF4 of frames, and python-can's CSV and SQLite"
)
STARTS: dict[bytes, Callable[[Path], Iterable[Any]]] = {
    b"LOGG": can.BLFReader, b"MDF     ": lambda path: reload(mf4).MF4Reader(path),
    b"SQLite format 3": can.SqliteReader, b";$FILEVERSION": can.TRCReader,
    b"timestamp,arbitration_id,": can.CSVReader,
}  # fmt: skip
"""Readers of python-can by a file's first bytes, whatever its name; that of MF4 finds asammdf only now (see
``invid_drivers``)."""
_ERROR = 0x20000000
"""Flag of an error frame in SocketCAN's identifier; the two above are extended and remote."""
_REMOTE = 0x40000000


@dataclass(frozen=True, eq=False)
class Frames:
    """Data frames of a log, in its order; a column of each, by name.

    ``time`` stamps [s]; ``elapsed`` [s] the stamps of everything that the log stamps, up to each frame, added
    up; ``identifier`` without flags; ``length`` [bytes]; ``channel`` the log's name of the bus; ``received``
    False where the logger sent the frame itself; ``number`` of the line, or in a binary log of the frame.
    """

    frame: pl.DataFrame
    broken: tuple[BrokenRow, ...]
    is_text: bool

    def __getitem__(self, name: str) -> Any:
        """(n,) of a column."""
        return self.frame[name].to_numpy()

    @cached_property
    def data(self) -> np.typing.NDArray[np.uint8]:
        """(n, longest) bytes, zeros behind the last."""
        longest = max(int(self["length"].max(initial=0)), 1)
        cells = self.frame["data"].str.slice(0, 2 * longest).str.pad_end(2 * longest, "0")
        return np.frombuffer(bytes.fromhex(cells.str.join("").item()), np.uint8).reshape(-1, longest)

    def where(self, rows: Bool) -> Frames:
        """The frames of a mask."""
        return self if rows.all() else Frames(self.frame.filter(rows), self.broken, self.is_text)

    def counts(self) -> dict[int, int]:
        """Identifier → frames, most first."""
        found = self.frame["identifier"].value_counts()
        return dict(found.sort("count", "identifier", descending=[True, False]).iter_rows())


def read_frames(path: Path) -> Frames:
    """The frames of a log.

    Raises
    ------
    InputError
        No frame of a kind known here.
    """
    start = FileStart.of(path)
    is_text = not start.head.startswith((*STARTS, *CAPTURES)) and "CANFD" not in start.text
    if (named := re.search(NAMED, start.text)) is not None:
        raise InputError(
            f"{path}: names its frame {named['name']!r}: the log was written with the names of a database in "
            "place of identifiers",
            way_out="export it again with identifiers ('symbolic' display off)",
            code="named_frames",
        )
    kind = _line_kind(start.text) if is_text else None
    try:
        frames = _of_lines(path, start.text, kind) if kind else _of_messages(path, _messages(path, start))
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        raise InputError(
            f"{path}: cannot be read as a CAN log: {first_line(error)}; read are {READ}", code="unreadable"
        ) from None
    if not frames.frame.height:
        raise InputError(
            f"{path}: no line of it is a CAN frame of a kind known here; read are {READ}", code="no_frames"
        )
    return frames


def _line_kind(head: str) -> str | None:
    lines = head.splitlines()[:50]
    return next(
        (kind for kind, pattern in LINES.items() if any(re.match(pattern, line) for line in lines)), None
    )


def _of_lines(path: Path, head: str, kind: str) -> Frames:
    """The frames of a text by the pattern of its lines; what looks like a frame and is none is broken."""
    first = next(m for line in head.splitlines() if (m := re.match(LINES[kind], line)))
    of, line = first.groupdict(), pl.col("line")
    is_decimal = bool(re.search(r"(?m)^\*\*\*DEC|^\s*base\s+dec", head))
    data = pl.col("data").fill_null("")
    if is_decimal:
        data = data.map_elements(lambda cells: bytes(map(int, cells.split())).hex(), return_dtype=pl.String)
    elif kind != "candump":
        data = data.str.replace_all(r"\b([0-9A-Fa-f])\b", "0$1").str.replace_all(r"[\s,]+", "")
    length = data.str.len_bytes() // 2
    stated = (
        length if "length" not in of else pl.col("length").str.to_integer(base=16 if kind == "asc" else 10)
    )
    channel = pl.col("channel")
    aside = line.str.contains(ASIDE) | (~line.str.contains(ASC_FRAME) if kind == "asc" else False)
    # A remote frame has a length and no data.
    is_whole = (length >= stated) | data.is_in(["", "R"])
    frame = (
        pl.scan_csv(
            path, has_header=False, separator="\x01", quote_char=None, schema={"line": pl.String},
            encoding="utf8-lossy", truncate_ragged_lines=True, glob=False,
        )
        .with_row_index("number", offset=1)
        .with_columns(line.str.strip_chars_end("\r").str.extract_groups(LINES[kind]).alias("parts"))
        .unnest("parts")
        .filter(pl.col("id").is_not_null() | ~aside.fill_null(True))
        .select(
            "number",
            pl.col("us").cast(pl.Float64) / 1e6 if "us" in of else pl.col("t").alias("us"),
            pl.col("id").str.strip_prefix("0x").str.to_integer(base=10 if is_decimal else 16),
            data.str.replace("^R.*$", "").alias("data"),
            pl.min_horizontal(length, stated).alias("length"),
            # python-can counts Vector's channels from 0, and so do maps.
            (channel.cast(pl.Int64) - 1).cast(pl.String) if kind == "asc" else channel,
            (pl.col("way").fill_null("R").str.to_uppercase() != "T").alias("received"),
            (is_whole & pl.col("id").is_not_null()).fill_null(False).alias("whole"),
            (data.str.starts_with("R") | (length < stated)).alias("empty"),
        )
        .collect(engine="streaming")
    )  # fmt: skip
    wrong = frame.filter(~pl.col("whole"))["number"].head(MAX_BROKEN).to_list()
    frame = frame.filter("whole")
    if frame["us"].dtype == pl.String:
        seconds = frame["us"].cast(pl.Float64, strict=False)
        dated = seconds_of(frame["us"]) if seconds.null_count() else None
        frame = frame.with_columns((seconds if dated is None else dated).alias("us"))
    broken = tuple(BrokenRow(path.name, n, "no whole CAN frame") for n in wrong)
    return _frames(frame.rename({"us": "time"}), broken, is_text=True)


def _frames(frame: pl.DataFrame, broken: tuple[BrokenRow, ...], *, is_text: bool) -> Frames:
    """The data frames among everything that a log stamps; the flags are in its ``id``."""
    frame = frame.with_columns(
        pl.col("time").cum_sum().alias("elapsed"), (pl.col("id") & 0x1FFFFFFF).alias("identifier")
    )
    return Frames(frame.filter((pl.col("id") & _ERROR == 0) & ~pl.col("empty")), broken, is_text)


_COLUMNS = {
    "number": pl.Int64, "time": pl.Float64, "id": pl.Int64, "data": pl.String, "length": pl.Int64,
    "channel": pl.String, "received": pl.Boolean, "empty": pl.Boolean,
}  # fmt: skip


def _of_messages(path: Path, messages: Iterable[Any]) -> Frames:
    parts, rows, broken, count = list[pl.DataFrame](), list[tuple[Any, ...]](), list[BrokenRow](), 0
    try:
        for count, m in enumerate(messages, 1):
            if count > MAX_FRAMES:
                raise InputError(f"{path}: more than {MAX_FRAMES} frames; cut the log", code="too_large")
            flags = m.arbitration_id | _ERROR * m.is_error_frame
            own = (str(m.channel), m.is_rx, m.is_remote_frame)
            rows.append((count, m.timestamp, flags, m.data.hex(), len(m.data), *own))
            if len(rows) == _BATCH:  # python-can's messages take fifty times their numbers
                parts.append(pl.DataFrame(rows, _COLUMNS, orient="row"))
                rows.clear()
    except InputError:
        raise
    except Exception as error:  # readers raise ValueError, IndexError, struct.error, BLFParseError by kind
        if not count:
            raise
        # A log that was cut off while it was written still has all frames before the cut.
        broken.append(BrokenRow(path.name, count + 1, f"the log breaks off: {first_line(error)}"))
    parts.append(pl.DataFrame(rows, _COLUMNS, orient="row"))
    return _frames(pl.concat(parts, rechunk=True), tuple(broken), is_text=False)


def _messages(path: Path, start: FileStart) -> Iterable[Any]:
    if start.head.startswith(CAPTURES):
        return _captured(path)
    reader = next((reader for first, reader in STARTS.items() if start.head.startswith(first)), None)
    if reader is None and re.search(r"(?m)^\s*base\s+(hex|dec)\b", start.text):
        reader = can.ASCReader
    return reader(path) if reader is not None else can.LogReader(path)


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
