"""Frames of text logs of CAN traffic.

Vector's ASC is python-can's; candump's screen, the CSV of SavvyCAN (GVRET) and BUSMASTER's log
no kept library reads, and the expression that tells a whole line of candump's log has read it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from invid.errors import InputError
from invid.recording.tables import BrokenRow

MAX_BROKEN = 100_000
READ = (
    "candump (-L, or its screen with -t a, z, d, A), Vector ASC, SavvyCAN/GVRET CSV, BUSMASTER, CanKing, "
    "and BLF, PEAK TRC, MF4 of frames, and python-can's CSV and SQLite"
)
# (1700000000.000210) can0 181#3712FCFFFAFFFFFF
_CANDUMP = re.compile(
    r"\s*\((\d+(?:\.\d+)?)\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"((?:[0-9A-Fa-f]{2}){0,8}|R\d?|#[0-9A-Fa-f](?:[0-9A-Fa-f]{2}){0,64})(?:\s+([TRtr]))?\s*$"
)
#  (1700000000.000210)  can0  181   [8]  37 12 FC FF FA FF FF FF
#  (2023-11-14 22:13:20.000210)  can0  RX - -  181   [8]  37 12 FC FF FA FF FF FF
_SHOWN = re.compile(
    r"\s*\((?:(?P<t>\d+(?:\.\d+)?)|(?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{6}))\)"
    r"\s+(?P<channel>\S+)\s+(?:(?P<way>[TR])X\s+)?(?:-\s+)*"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(?P<length>\d)\](?P<data>(?:\s+[0-9A-Fa-f]{2})*)\s*(?:'.*)?$"
)
# 166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,
_GVRET = re.compile(
    r"\s*(?P<us>\d+),\s*(?P<id>[0-9A-Fa-f]+),\s*(?P<extended>true|false|0|1),\s*(?:(?P<way>[RT])x,\s*)?"
    r"(?P<channel>\d+),\s*(?P<length>\d+)(?P<data>(?:,\s*[0-9A-Fa-f]{0,2})*)\s*$",
    re.IGNORECASE,
)
# 12:36:19:0160 Rx 1 0x181 s 8 37 12 FC FF FA FF FF FF
_BUSMASTER = re.compile(
    r"\s*(?P<h>\d+):(?P<m>\d+):(?P<s>\d+):(?P<tenth>\d{4})\s+(?P<way>[RT])x\s+(?P<channel>\d+)\s+(?P<id>0x[0-9A-Fa-f]+|\d+)"
    r"\s+(?P<kind>[sx])r?\s+(?P<length>\d)(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*)\s*$"
)
# 0    00000181         8  37 12 FC FF FA FF FF FF       0.000210 R
_KVASER = re.compile(
    r"\s*(?P<channel>\d+)\s+(?P<id>[0-9A-Fa-f]{8})\s+(?P<kind>X\s+)?(?P<length>\d)"
    r"(?P<data>(?:\s+[0-9A-Fa-f]{2})*)\s+(?P<t>\d+\.\d+)\s+(?P<way>[RT])\s*$"
)
_FOREIGN = (_SHOWN, _GVRET, _BUSMASTER, _KVASER)
_ASIDE = re.compile(r"\s*$|\s*#|\s*\*\*\*|\s*Time ?Stamp\b|Chn Identifier\b")
"""Empty lines, comments, and the headers of BUSMASTER, SavvyCAN and Kvaser's CanKing."""
#    0.002100 1  181             Rx   d 8 37 12 FC FF FA FF FF FF
_ASC_FRAME = re.compile(r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\b")
#    0.002100 1  SYNC            Rx   d 0
_ASC_NAMED = re.compile(r"\s*\d+\.\d+\s+\d+\s+(?P<name>\S+)\s+[RT]x\s+d\s+[0-9A-Fa-f]\b")
_ASC_WHOLE = re.compile(
    r"\s*\d+\.\d+\s+\d+\s+[0-9A-Fa-f]+x?\s+[RT]x\s+d\s+([0-9A-Fa-f])((\s+[0-9A-Fa-f]{1,3})*)(\s.*)?$"
)


HEADER = re.compile(
    # timestamp,arbitration_id,extended,remote,error,dlc,data
    r"\Atimestamp,arbitration_id,extended,remote,error,dlc,data"
    # Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    r"|\ATime Stamp,ID,Extended"
    # base hex  timestamps absolute
    r"|^\s*base\s+(?:hex|dec)\s+timestamps\s+(?:absolute|relative)"
    rf"|^(?:{_CANDUMP.pattern})|^(?:{_SHOWN.pattern})|\AChn Identifier\b",
    re.MULTILINE,
)
"""A head or a line that only a CAN log has."""


def is_text_log(head: str) -> bool:
    """Whether one of a file's first lines is a CAN frame or a header that only such logs have."""
    if head.startswith("***BUSMASTER") or HEADER.search(head):
        return True
    return any(
        _CANDUMP.match(line) or any(k.match(line) for k in _FOREIGN) for line in head.splitlines()[:20]
    )


class Frame(NamedTuple):
    """What python-can's ``Message`` is read for."""

    timestamp: float
    arbitration_id: int
    data: bytes
    channel: str
    is_rx: bool = True
    is_remote_frame: bool = False
    is_error_frame: bool = False


_ERROR = 0x20000000
"""Flag of an error frame in candump's identifier (SocketCAN's CAN_ERR_FLAG)."""


class Lines:
    """Frames of a text log with the numbers of their lines, without lines that are broken: those are kept."""

    def __init__(self, path: Path, broken: list[BrokenRow]) -> None:
        self._file = path.open(encoding="utf-8", errors="replace")
        self._path, self._name, self._broken = path, path.name, broken
        head = self._file.read(4096)
        self._file.seek(0)
        self.is_asc = path.suffix.lower() == ".asc" or bool(re.search(r"^\s*base\s+(hex|dec)\b", head, re.M))
        self.number = 0
        self._base = 16
        """Of BUSMASTER's numbers, which its header states."""

    def __iter__(self) -> Iterator[Any]:
        """Its frames; of an ASC the lines, for python-can's reader."""
        read = self._asc_line if self.is_asc else self._frame
        for line in self._file:
            self.number += 1
            whole = read(line)
            if whole is not None:
                yield whole
            elif not _ASIDE.match(line) and len(self._broken) < MAX_BROKEN:
                self._broken.append(BrokenRow(self._name, self.number, "no whole CAN frame"))

    def _frame(self, line: str) -> Frame | None:
        found = _CANDUMP.match(line)
        if found is None:
            if line.startswith("***DEC"):
                self._base = 10
            other = next((m for kind in _FOREIGN if (m := kind.match(line))), None)
            return None if other is None else self._foreign(other)
        stamp, channel, number, data, way = found.groups()
        identifier, received = int(number, 16), way is None or way in "Rr"
        if data[:1] == "R":
            return Frame(float(stamp), identifier, b"", channel, received, True)
        data = data[2:] if data[:1] == "#" else data
        wrong = bool(identifier & _ERROR)
        return Frame(float(stamp), identifier, bytes.fromhex(data), channel, received, False, wrong)

    def _foreign(self, found: re.Match[str]) -> Frame | None:
        part = found.groupdict()
        cells = part["data"].replace(",", " ").split()
        length = int(part["length"])
        if len(cells) < length:
            return None
        base = self._base if found.re is _BUSMASTER else 16
        if part.get("date"):
            stamp = datetime.fromisoformat(part["date"]).replace(tzinfo=UTC).timestamp()
        elif found.re is _BUSMASTER:
            stamp = (int(part["h"]) * 60 + int(part["m"])) * 60 + int(part["s"]) + 1e-4 * int(part["tenth"])
        else:
            stamp = int(part["us"]) / 1e6 if found.re is _GVRET else float(part["t"])
        identifier = int(part["id"], 16 if part["id"].startswith("0x") else base)
        data = bytes(int(c, base) for c in cells[:length])
        return Frame(stamp, identifier, data, part["channel"], (part["way"] or "R").upper() == "R")

    def _asc_line(self, line: str) -> str | None:
        if _ASC_FRAME.match(line):
            whole = _ASC_WHOLE.match(line)
            return line if whole and len(whole[2].split()) >= int(whole[1], 16) else None
        named = _ASC_NAMED.match(line)
        if named is not None:
            raise InputError(
                f"{self._path}: line {self.number} names its frame {named['name']!r}: the log was written "
                "with the names of a database in place of identifiers; export it again with identifiers "
                "('symbolic' display off)"
            )
        # Header, comments, events of other kinds: the reader knows which of them matter.
        return line

    def close(self) -> None:
        """Close the file."""
        self._file.close()


__all__ = ["READ", "Frame", "Lines", "is_text_log"]
