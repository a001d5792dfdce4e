"""EDS and DCF files: what a CANopen device says of itself before anybody asks it.

``canopen`` reads them. Vendors' files often break the rules (an option twice, a PDO map without a
default); whoever reads one must expect that it does not parse.
"""

from __future__ import annotations

import configparser
import io
import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary, ODVariable, import_od

from invid.errors import InputError
from invid.recording.text_encoding import decode_text


@dataclass(frozen=True)
class Declared:
    """A device as its file describes it."""

    path: Path
    vendor_id: int | None
    product_code: int | None
    revision: int | None
    """[DeviceInfo] RevisionNumber."""
    variables: Mapping[tuple[int, int], ODVariable]
    """By index and subindex."""
    rpdos: int
    tpdos: int

    def find(self, index: int, sub: int) -> ODVariable | None:
        """The entry of an object; ``None`` where the device lacks it."""
        return self.variables.get((index, sub))


def stated(variable: ODVariable | None) -> Any:
    """ParameterValue of a DCF, else DefaultValue; ``None`` where a file states neither."""
    if variable is None:
        return None
    return variable.default if variable.value is None else variable.value


def parse_eds(path: Path, node_id: int) -> Declared:
    """Read an EDS (or DCF) file; ``node_id`` stands for $NODEID in it.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It does not parse, with the reason.
    """
    od = load_dictionary(path, node_id)
    found = [v for o in od.values() for v in ([o] if isinstance(o, ODVariable) else o.values())]
    objects = {(v.index, v.subindex): v for v in found}
    if not any(index >= 0x1000 for index, _ in objects):
        raise ValueError("does not parse (it lists no objects)")
    return Declared(
        path=path,
        vendor_id=od.device_information.vendor_number,
        product_code=od.device_information.product_number,
        revision=od.device_information.revision_number,
        variables=objects,
        rpdos=sum((0x1400 + n, 1) in objects for n in range(512)),
        tpdos=sum((0x1800 + n, 1) in objects for n in range(512)),
    )


def load_dictionary(path: Path, node_id: int) -> ObjectDictionary:
    """The object dictionary that canopen reads from an EDS or DCF file; ``node_id`` stands for $NODEID.

    Vendors write what the library takes no number from: other encodings than UTF-8, marks before the first
    line, zeros before a decimal number. What it logs of the file carries the file's name.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        It does not parse, with the reason.
    """
    text = _LEADING_ZEROS.sub(r"\1\2", _text(path))
    try:
        stream = io.StringIO(_with_sub_objects(text) if _COMPACT.search(text) else text)
    except configparser.Error as error:
        raise ValueError(f"does not parse ({' '.join(str(error).split())})") from None
    # The ending decides what the library takes it for; a file that a map names is one whatever its ending.
    stream.name = str(path) if path.suffix.lower() in (".eds", ".dcf") else f"{path}.eds"
    log = logging.getLogger("canopen.objectdictionary.eds")

    def named(record: logging.LogRecord) -> bool:
        record.msg, record.args = f"{path}: {record.getMessage()}", ()
        return True

    log.addFilter(named)
    try:
        return import_od(stream, node_id)
    except (
        configparser.Error,
        canopen.ObjectDictionaryError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
    ) as error:
        reason = " ".join(str(error).replace(f"While reading from {str(path)!r} ", "").split())
        reason = reason or type(error).__name__
        raise ValueError(f"does not parse ({reason})") from None
    finally:
        log.removeFilter(named)


_LEADING_ZEROS = re.compile(
    r"^(\s*(?:DataType|ObjectType|SubNumber|PDOMapping|LowLimit|HighLimit|DefaultValue|ParameterValue|NrOf\w+|Lines"
    r"|\w+Number|BaudRate_\d+|Dummy\d+|Baudrate|NodeID)\s*=\s*)0+([0-9]+\s*(?:;.*)?)$",
    re.MULTILINE | re.IGNORECASE,
)


_COMPACT = re.compile(r"^\s*CompactSubObj\s*=\s*0*[1-9]", re.MULTILINE | re.IGNORECASE)


def _with_sub_objects(text: str) -> str:
    """The file with a section for each entry of what it lists in the compact form of CiA 306.

    ``CompactSubObj`` entries of one type, values of their own in ``[<index>Value]``.
    """
    file = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";",), interpolation=None)
    file.optionxform = str  # type: ignore[assignment,method-assign]
    file.read_string(text)
    own = {s.lower(): {k.lower(): v for k, v in file.items(s)} for s in file.sections()}
    for section in file.sections():
        said = own[section.lower()]
        count = int(said.get("compactsubobj", "0") or "0", 0)
        if not count or not re.fullmatch(r"[0-9A-Fa-f]{4}", section):
            continue
        names, values = (own.get(f"{section}{kind}".lower(), {}) for kind in ("Name", "Value"))
        for sub in range(count + 1):
            place = f"{section}sub{sub:X}"
            if place.lower() in own:
                continue
            file.add_section(place)
            entry = {
                "ParameterName": names.get(str(sub), f"{said.get('parametername', section)} {sub}"),
                "ObjectType": "0x7",
                "DataType": said.get("datatype", "0x0007") if sub else "0x0005",
                "AccessType": said.get("accesstype", "rw"),
                "PDOMapping": said.get("pdomapping", "0") if sub else "0",
                "DefaultValue": said.get("defaultvalue", "") if sub else str(count),
            }
            value = values.get(str(sub), values.get(f"0x{sub:x}", "" if sub else str(len(values) or count)))
            for key, content in {**entry, "ParameterValue": value}.items():
                if content:
                    file.set(place, key, content)
        for key in [k for k in file[section] if k.lower() in ("compactsubobj", "objecttype", "subnumber")]:
            file.remove_option(section, key)
        file.set(section, "ObjectType", said.get("objecttype", "0x8"))
        file.set(section, "SubNumber", str(count + 1))
        for kind in ("Name", "Value"):
            file.remove_section(
                next((s for s in file.sections() if s.lower() == f"{section}{kind}".lower()), "")
            )
    out = io.StringIO()
    file.write(out)
    return out.getvalue()


def _text(path: Path) -> str:
    try:
        return decode_text(path.read_bytes(), None, str(path))[0]
    except InputError:
        raise ValueError("does not parse (it is no text in a usual encoding)") from None
