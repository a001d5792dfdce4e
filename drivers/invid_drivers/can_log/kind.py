"""What a CAN log is recognised by: its first bytes, or a line that only such logs have."""

from __future__ import annotations

import re

from invid.recording.readers.kinds import FileKind

_HEX = r"[0-9A-Fa-f]"
LINES = {
    # (1700000000.000210) can0 181#3712FCFFFAFFFFFF
    "candump": rf"^\s*\((?P<t>\d+(?:\.\d+)?)\)\s+(?P<channel>\S+)\s+(?P<id>{_HEX}{{3}}|{_HEX}{{8}})#"
    rf"(?P<flags>#{_HEX})?(?P<data>(?:{_HEX}{{2}}){{0,64}}|R{_HEX}?)(?:\s+(?P<way>[TRtr]))?\s*$",
    #    0.002100 1  181             Rx   d 8 37 12 FC FF FA FF FF FF
    "asc": rf"^\s*(?P<t>\d+\.\d+)\s+(?P<channel>\d+)\s+(?P<id>{_HEX}+)x?\s+(?P<way>[RT])x\s+d\s+"
    rf"(?P<length>{_HEX})(?P<data>(?:\s+{_HEX}{{1,3}})*)(?:\s.*)?$",
    #  (1700000000.000210)  can0  RX - -  181   [8]  37 12 FC FF FA FF FF FF
    "screen": rf"^\s*\((?P<t>\d+\.?\d*|\d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{{6}})\)\s+(?P<channel>\S+)\s+"
    rf"(?:(?P<way>[TR])X\s+)?(?:-\s+)*(?P<id>{_HEX}{{3}}|{_HEX}{{8}})\s+\[(?P<length>\d+)\]"
    rf"(?P<data>(?:\s+{_HEX}{{2}})*)\s*(?:'.*)?$",
    # 166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,
    "gvret": rf"^\s*(?P<us>\d+),\s*(?P<id>{_HEX}+),\s*(?i:true|false|0|1),\s*(?:(?P<way>[RTrt])x,\s*)?"
    rf"(?P<channel>\d+),\s*(?P<length>\d+)(?P<data>(?:,\s*{_HEX}{{0,2}})*)\s*$",
    # 12:36:19:0160 Rx 1 0x181 s 8 37 12 FC FF FA FF FF FF
    "busmaster": rf"^\s*(?P<t>\d+:\d+:\d+:\d{{4}})\s+(?P<way>[RT])x\s+(?P<channel>\d+)\s+"
    rf"(?P<id>0x{_HEX}+|\d+)\s+[sx]r?\s+(?P<length>\d)(?P<data>(?:\s+{_HEX}{{1,3}})*)\s*$",
    # 0    00000181         8  37 12 FC FF FA FF FF FF       0.000210 R
    "canking": rf"^\s*(?P<channel>\d+)\s+(?P<id>{_HEX}{{8}})\s+(?:X\s+)?(?P<length>\d)"
    rf"(?P<data>(?:\s+{_HEX}{{2}})*)\s+(?P<t>\d+\.\d+)\s+(?P<way>[RT])\s*$",
}
ASC_FRAME = rf"^\s*\d+\.\d+\s+(CANFD|\d+\s+{_HEX}+x?\s+[RT]x\s+d)\b"
"""What of an ASC is meant as a frame; its other lines are events."""
#    0.002100 1  SYNC            Rx   d 0
NAMED = rf"(?m)^\s*\d+\.\d+\s+\d+\s+(?!{_HEX}+x?\s)(?P<name>\S+)\s+[RT]x\s+d\s+{_HEX}\b"
"""A frame of an ASC under the name that a database has for it."""
ASIDE = r"^\s*$|^\s*#|^\s*\*\*\*|^\s*Time ?Stamp\b|^Chn Identifier\b"
"""Empty lines, comments, and the headers of BUSMASTER, SavvyCAN and Kvaser's CanKing."""
HEADER = "|".join(
    [
        # timestamp,arbitration_id,extended,remote,error,dlc,data
        r"\Atimestamp,arbitration_id,extended,remote,error,dlc,data",
        # Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
        r"\ATime Stamp,ID,Extended",
        # base hex  timestamps absolute
        r"^\s*base\s+(?:hex|dec)\s+timestamps\s+(?:absolute|relative)",
        r"\AChn Identifier\b",
        *(re.sub(r"\?P<\w+>", "?:", LINES[k]) for k in ("candump", "screen", "canking")),
    ]
)
"""A head or a line that only a CAN log has."""
CAPTURES = (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d", b"\n\r\r\n")
"""First bytes of pcap (µs, ns, either byte order) and pcapng."""
CAN_LOG = FileKind(
    "can_log",
    "invid_drivers.can_log.table:read_log",
    (b"LOGG", b"***BUSMASTER", b";$FILEVERSION", *CAPTURES),
    (".log", ".asc", ".blf", ".trc", ".pcap", ".pcapng", ".cap"),
    HEADER,
)
"""The kind that the entry point names."""
