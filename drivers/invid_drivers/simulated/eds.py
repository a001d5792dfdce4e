"""EDS files of the simulated drives: written from the table of vendors, and read back into a drive.

    python -m invid_drivers.simulated.eds FOLDER

writes one file for every row of ``vendors.PROFILES``, and prints the table of the docs; ``drivers/eds`` is
made so.
"""

from __future__ import annotations

import sys
from pathlib import Path

from invid.errors import ConfigError
from invid_drivers.eds import parse_eds
from invid_drivers.simulated.object_dictionary import Entry, Nameplate, ObjectDictionary, drive_dictionary
from invid_drivers.simulated.vendors import PROFILES, Profile

TYPES = {"b": 0x2, "h": 0x3, "i": 0x4, "B": 0x5, "H": 0x6, "I": 0x7, "s": 0x9}
_CODES = {number: code for code, number in TYPES.items()}
_RATED, _COUNTS = 100.0, 524288
_DUMMIES = range(0x1, 0x8)


def profile_dictionary(profile: Profile, node_id: int) -> ObjectDictionary:
    """The object dictionary of a vendor's row with a motor of 100 N·m and 2¹⁹ counts."""
    plate = Nameplate("invid drive", serial=0, rated_torque=_RATED, encoder_counts=_COUNTS)
    return drive_dictionary(node_id, plate, profile)


def eds_text(name: str) -> str:
    """The EDS file of a vendor's row."""
    profile = PROFILES[name]
    one, two = profile_dictionary(profile, 1), profile_dictionary(profile, 2)
    by_index: dict[int, list[Entry]] = {}
    for entry in one:
        by_index.setdefault(entry.index, []).append(entry)
    title = str(profile.values.get((0x1008, 0), "generic (simulated)"))
    lines = [
        "; Made by invid_drivers.simulated.eds from the table of vendors' differences. No vendor's file.",
        "[FileInfo]", f"FileName={name}.eds", "FileVersion=1", "FileRevision=1", "EDSVersion=4.0",
        f"Description={title}", "",
        "[DeviceInfo]", "VendorName=invid", "VendorNumber=0x0", f"ProductName={title}", "ProductNumber=0x402",
        "RevisionNumber=1", "BaudRate_500=1", "BaudRate_1000=1", "SimpleBootUpSlave=1",
        f"NrOfRXPDO={profile.rpdos}", f"NrOfTXPDO={profile.tpdos}", "LSS_Supported=0", "",
        "[DummyUsage]",
        *[f"Dummy{i:04X}={int(profile.dummy_mapping)}" for i in _DUMMIES], "",
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


def apply_eds(od: ObjectDictionary, path: Path, node_id: int) -> None:
    """Make a drive what an EDS says: its objects and no others, with its values.

    Raises
    ------
    ConfigError
        Where the file cannot be read or does not parse: there is then nothing to simulate.
    """
    try:
        declared = parse_eds(path, node_id)
    except OSError as error:
        raise ConfigError(f"simulation: EDS {path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise ConfigError(f"simulation: EDS {path}: {error}") from None
    for entry in list(od):
        dummy = entry.index in _DUMMIES
        if (entry.index, entry.sub) not in declared.objects and not (dummy and declared.dummies):
            od.remove_entry(entry.index, entry.sub)
    for variable in declared.variables:
        code = _CODES.get(variable.data_type)
        if code is None:
            continue
        known = od.find(variable.index, variable.sub)
        if known is None:
            known = od.add(variable.index, variable.sub, code, variable.access, 0)
        if not variable.mappable:
            known.mappable = ""
        if isinstance(variable.default, (str, int)) and (code == "s") == isinstance(variable.default, str):
            known.value = known.default = variable.default


_COLUMNS = {
    "0x6071": (0x6071, 0), "0x6077": (0x6077, 0), "0x6072": (0x6072, 0), "0x6076": (0x6076, 0),
    "0x605A": (0x605A, 0), "0x6007": (0x6007, 0), "0x1016": (0x1016, 1), "0x608F": (0x608F, 1),
}  # fmt: skip


def table(folder: Path) -> str:
    """What each file says, as a table of the docs."""
    lines = ["| EDS | " + " | ".join(_COLUMNS) + " | dummies | RPDO/TPDO |"]
    lines.append("| --- " * (len(_COLUMNS) + 3) + "|")
    for path in sorted(folder.glob("*.eds")):
        try:
            declared = parse_eds(path, 1)
        except ValueError as error:
            lines.append(f"| {path.stem} | " + " | ".join([""] * len(_COLUMNS)) + f" | | {error} |")
            continue
        cells = []
        for index, sub in _COLUMNS.values():
            entry = declared.find(index, sub)
            word = "–" if entry is None else f"{entry.access}{', PDO' if entry.mappable else ''}"
            if entry is not None and index in (0x6072, 0x6076, 0x605A, 0x6007):
                word += f", {entry.default}"
            cells.append(word)
        counts = f"{declared.rpdos}/{declared.tpdos}"
        lines.append(
            f"| {path.stem} | {' | '.join(cells)} | {'yes' if declared.dummies else '–'} | {counts} |"
        )
    return "\n".join(lines)


def main(folder: Path) -> None:
    """Write every file, and one that breaks the rules as vendors' files do; print the table of the docs."""
    for name in PROFILES:
        (folder / f"{name}.eds").write_text(eds_text(name), encoding="utf-8")
    (folder / "does_not_parse.eds").write_text(twice(eds_text("generic")), encoding="utf-8")
    print(table(folder))


def twice(text: str) -> str:
    """The text with an option given twice, which some vendors' files have and no parser takes."""
    return text.replace("DataType=0x0006\n", "DataType=0x0006\nDataType=0x0006\n", 1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
