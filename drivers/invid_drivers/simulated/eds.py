"""EDS files read into a simulated drive."""

from __future__ import annotations

from pathlib import Path

from invid.errors import ConfigError
from invid_drivers.eds import parse_eds, stated
from invid_drivers.simulated.object_dictionary import ObjectDictionary

TYPES = {"b": 0x2, "h": 0x3, "i": 0x4, "B": 0x5, "H": 0x6, "I": 0x7, "s": 0x9}
_CODES = {number: code for code, number in TYPES.items()}


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
        if (entry.index, entry.sub) not in declared.variables:
            od.remove_entry(entry.index, entry.sub)
    for (index, sub), variable in declared.variables.items():
        code, value = _CODES.get(variable.data_type or 0), stated(variable)
        if code is None or index < 0x1000:  # a dummy, which fills a gap of a receive PDO
            continue
        known = od.find(index, sub) or od.add(index, sub, code, variable.access_type, 0)
        if not variable.pdo_mappable:
            known.mappable = ""
        if isinstance(value, (str, int)) and (code == "s") == isinstance(value, str):
            known.value = known.default = value
