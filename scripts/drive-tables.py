"""Files and tables of drives that stand in the tree: ``python scripts/drive-tables.py``.

Writes ``drivers/eds`` from the profiles of the simulated drives, and prints what ``docs/reference/drives.md``
shows: the facts of the manuals with their sources, and how each drive is shaken.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from invid_drivers.cia402.stated.vendors import VENDORS, Answer, Manual
from invid_drivers.simulated.eds import TYPES
from invid_drivers.simulated.object_dictionary import Entry, Nameplate, ObjectDictionary, drive_dictionary
from invid_drivers.simulated.vendors import PROFILES, Profile

FILES = Path(__file__).parents[1] / "drivers" / "eds"
_RATED, _COUNTS, _RAMPS = 100.0, 524288, (166886, 834430)  # ramps: 2 and 10 rad/s² in counts
_DUMMIES = range(0x1, 0x8)
UNKNOWN = Answer.UNKNOWN.value


def profile_dictionary(profile: Profile, node_id: int) -> ObjectDictionary:
    """The object dictionary of a vendor's row with a motor of 100 N·m and 2¹⁹ counts."""
    plate = Nameplate("invid drive", serial=0, rated_torque=_RATED, encoder_counts=_COUNTS)
    return drive_dictionary(node_id, plate, profile, _RAMPS)


def eds_text(name: str) -> str:
    """The EDS file of a vendor's row."""
    profile = PROFILES[name]
    one, two = profile_dictionary(profile, 1), profile_dictionary(profile, 2)
    by_index: dict[int, list[Entry]] = {}
    for entry in one:
        by_index.setdefault(entry.index, []).append(entry)
    title = str(profile.values.get((0x1008, 0), "generic (simulated)"))
    lines = [
        "; Made by scripts/drive-tables.py from the table of vendors' differences. No vendor's file.",
        "[FileInfo]", f"FileName={name}.eds", "FileVersion=1", "FileRevision=1", "EDSVersion=4.0",
        f"Description={title}", "",
        "[DeviceInfo]", "VendorName=invid", "VendorNumber=0x0", f"ProductName={title}", "ProductNumber=0x402",
        "RevisionNumber=1", "BaudRate_500=1", "BaudRate_1000=1", "SimpleBootUpSlave=1",
        f"NrOfRXPDO={profile.rpdos}", f"NrOfTXPDO={profile.tpdos}", "LSS_Supported=0", "",
        "[DummyUsage]",
        *[f"Dummy{i:04X}={int(2 not in profile.lacks)}" for i in _DUMMIES], "",
    ]  # fmt: skip
    real = sorted(i for i in by_index if i >= 0x1000)
    mandatory = [i for i in (0x1000, 0x1001, 0x1018) if i in by_index]
    for section, chosen in (
        ("MandatoryObjects", mandatory),
        ("OptionalObjects", [i for i in real if i not in mandatory and not 0x2000 <= i < 0x6000]),
        ("ManufacturerObjects", [i for i in real if 0x2000 <= i < 0x6000]),
    ):
        lines += [f"[{section}]", f"SupportedObjects={len(chosen)}"]
        lines += [f"{n}=0x{i:04X}" for n, i in enumerate(chosen, start=1)] + [""]
    for index in real:
        entries = sorted(by_index[index], key=lambda e: e.sub)
        if len(entries) == 1 and entries[0].sub == 0:
            lines += [f"[{index:04X}]", *_variable(entries[0], two)]
            continue
        lines += [
            f"[{index:04X}]",
            f"ParameterName={index:04X}",
            "ObjectType=0x9",
            f"SubNumber={len(entries)}",
        ]
        lines.append("")
        for entry in entries:
            lines += [f"[{index:04X}sub{entry.sub:X}]", *_variable(entry, two)]
    return "\n".join(lines)


def _variable(entry: Entry, other: ObjectDictionary) -> list[str]:
    second = other.entry(entry.index, entry.sub).value
    value = str(entry.value)
    if isinstance(entry.value, int) and isinstance(second, int) and second != entry.value:
        value = f"$NODEID+0x{entry.value - 1:X}"
    access = {"rw": "rww" if "w" in entry.mappable else "rw"}.get(entry.access, entry.access)
    return [
        f"ParameterName={entry.index:04X}:{entry.sub}",
        "ObjectType=0x7",
        f"DataType=0x{TYPES[entry.code]:04X}",
        f"AccessType={access}",
        f"DefaultValue={value}",
        f"PDOMapping={int(bool(entry.mappable))}",
        "",
    ]


_COLUMNS = {
    "0x6071": (0x6071, 0), "0x6077": (0x6077, 0), "0x6072": (0x6072, 0), "0x6076": (0x6076, 0),
    "0x605A": (0x605A, 0), "0x6007": (0x6007, 0), "0x1016": (0x1016, 1), "0x608F": (0x608F, 1),
}  # fmt: skip


def twice(text: str) -> str:
    """The text with an option given twice, which some vendors' files have and no parser takes."""
    return text.replace("DataType=0x0006\n", "DataType=0x0006\nDataType=0x0006\n", 1)


def fact(row: Manual, name: str) -> str:
    """A field in words."""
    value = getattr(row, name)
    if isinstance(value, Answer):
        return value.value
    if isinstance(value, tuple):
        return ", ".join(str(v) for v in value) or UNKNOWN
    return UNKNOWN if value is None else str(value)


QUESTIONS = {
    "cyclic_torque": "cyclic synchronous torque",
    "torque_offset": "0x60B2 in cyclic position",
    "enforces_torque_limit": "0x6072 acts in torque mode",
    "quick_stop_default": "0x605A as delivered",
    "quick_stop_values": "0x605A takes",
    "quick_stop_ramp_unit": "unit of 0x6085",
    "ramp_capped_by_torque_limit": "0x6072 caps that ramp",
    "heartbeat_lost": "heartbeat lost",
    "rpdo_event_timer": "0x1400:5 event timer",
    "sync_supervision": "notices missing SYNC",
    "brake_closes": "brake closes",
    "torque_until_brake_closed": "torque until it has closed",
    "position_before_gear": "0x6064 before the gear",
}
"""Each field and the words for it."""


def facts(rows: Mapping[str, Manual]) -> str:
    """The facts of every drive as a Markdown table, a drive a column; unknowns are dashes."""
    lines = ["| | " + " | ".join(f"`{name}`" for name in rows) + " |", "| --- " * (len(rows) + 1) + "|"]
    for name, words in QUESTIONS.items():
        cells = [fact(row, name) for row in rows.values()]
        lines.append(f"| {words} | " + " | ".join("–" if c == "unknown" else c for c in cells) + " |")
    return "\n".join(lines)


def sources(rows: Mapping[str, Manual]) -> str:
    """Where the facts were read, as a Markdown list (each fact with its own in ``Manual.sources``)."""
    return "\n".join(
        f"- `{vendor}`: {'; '.join(dict.fromkeys(row.sources.values()))}." for vendor, row in rows.items()
    )


def ways() -> str:
    """How each drive can be shaken, as a Markdown table: what was read, or what its EDS says."""
    lines = ["| `vendor` | shaken by |", "| --- | --- |"]
    for name, row in VENDORS.items():
        if not row.sources:
            way = "as the drive says: cyclic or profile torque, else the torque offset in cyclic position"
        elif "EtherCAT" in row.advice:
            way = "its own recorder and `invid import`"
        elif row.cyclic_torque.certain:
            also = ", and has the torque offset" if row.torque_offset.certain else ""
            way = f"cyclic torque{also}"
        elif row.torque_offset.certain:
            way = "the torque offset in cyclic position"
        else:
            way = "its own recorder and `invid import`"
        lines.append(f"| `{name}` | {way} |")
    return "\n".join(lines)


def reference() -> str:
    """The table of facts and the list of sources, as they stand in docs/reference/drives.md."""
    read = {name: row for name, row in VENDORS.items() if row.sources}
    return f"{facts(read)}\n\n{sources(read)}"


def main() -> None:
    """Write every file, and one that breaks the rules as vendors' files do; print the tables."""
    for name in PROFILES:
        (FILES / f"{name}.eds").write_text(eds_text(name), encoding="utf-8")
    (FILES / "does_not_parse.eds").write_text(twice(eds_text("generic")), encoding="utf-8")
    print(f"{reference()}\n\n{ways()}")


if __name__ == "__main__":
    main()
