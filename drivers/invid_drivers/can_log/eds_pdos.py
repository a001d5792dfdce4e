"""PDOs of a CAN log as an EDS or DCF maps them: all of up to 512, each object as long as the mapping says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes

from invid.errors import InputError
from invid.recording.import_map import Pdo, Signal
from invid_drivers.eds import load_dictionary, stated

_COUNT = 512
_PREDEFINED = 4
"""PDOs whose identifiers CiA 301 gives where a file gives none."""
_DIRECTIONS = (("from_drive", 0x1A00, 0x1800, 0x180), ("to_drive", 0x1600, 0x1400, 0x200))
_DISABLED = 1 << 31
_EXTENDED = 1 << 29
_SIZES = (8, 16, 32, 64)


def pdos_of_eds(path: Path, nodes: list[int]) -> tuple[list[Pdo], tuple[str, ...]]:
    """PDO mappings of an EDS or DCF, configured or default; columns ``n<node>_<object in hex>``.

    With them sentences on what the file says twice and differently.

    Raises
    ------
    InputError
        A file that does not parse or maps nothing; no nodes.
    """
    if not nodes:
        raise InputError("map: 'eds' needs 'nodes': the node numbers of the drives in the log")
    if not path.is_file():
        raise InputError(f"{path}: no such EDS file")
    found: list[Pdo] = []
    remarks: list[str] = []
    for node in nodes:
        try:
            dictionary = load_dictionary(path, node)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        for direction, mapping, communication, base in _DIRECTIONS:
            for k in range(_COUNT):
                signals = list(_signals(dictionary, mapping + k, node, remarks))
                identifier = _value(dictionary, communication + k, 1) or 0
                if not signals or identifier & _DISABLED:
                    continue
                number = identifier & (0x1FFFFFFF if identifier & _EXTENDED else 0x7FF)
                if not number and k >= _PREDEFINED:
                    remarks.append(
                        f"{path.name}: 0x{mapping + k:X} is mapped, but 0x{communication + k:X}:1 gives it "
                        "no identifier; it is not read"
                    )
                    continue
                number = number or base + 0x100 * k + node
                found.append(Pdo.model_validate({"id": number, "direction": direction, "signals": signals}))
    if not found:
        raise InputError(f"{path}: maps no object into a PDO by default; give 'pdos' in the map instead")
    return found, tuple(dict.fromkeys(remarks))


def _value(dictionary: ObjectDictionary, index: int, sub: int) -> int | None:
    value = stated(dictionary.get_variable(index, sub))
    return value if isinstance(value, int) else None


def _signals(dictionary: ObjectDictionary, index: int, node: int, remarks: list[str]) -> Iterator[Signal]:
    for sub in range(1, (_value(dictionary, index, 0) or 0) + 1):
        entry = _value(dictionary, index, sub)
        if not entry:
            continue
        target, part, bits = entry >> 16, (entry >> 8) & 0xFF, entry & 0xFF
        name = f"n{node}_{target:04X}" + (f"_{part}" if part else "")
        variable = dictionary.get_variable(target, part)
        kind = None if variable is None else _kind(variable, bits)
        if kind is None:
            yield Signal(name=name, type="skip", bits=bits)
            continue
        if variable is not None and len(variable) not in (bits, 1):
            remarks.append(
                f"{name}: 0x{index:X}:{sub} maps {bits} bits of 0x{target:04X}:{part}, whose type in the "
                f"file has {len(variable)}; the mapping's {bits} were read, as the drive sends them"
            )
        yield Signal.model_validate({"name": name, "type": kind})


def _kind(variable: ODVariable, bits: int) -> str | None:
    """The type of a mapped object: its length is the mapping's, sign and kind are the type's."""
    data_type = variable.data_type
    if data_type in datatypes.FLOAT_TYPES:
        return f"float{bits}" if bits == len(variable) else None
    if bits not in _SIZES:
        return None
    if data_type in datatypes.SIGNED_TYPES:
        return f"int{bits}"
    return f"uint{bits}" if data_type in datatypes.UNSIGNED_TYPES else None
