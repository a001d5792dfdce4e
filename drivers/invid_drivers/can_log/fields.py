"""Numbers in CAN frames: any number of bits in either byte order, from a map's PDOs, an EDS or a DBC."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cantools
import numpy as np
from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes

from invid.errors import InputError
from invid.numerics.arrays import Bool, Float64
from invid.recording.import_map import Pdo, Signal
from invid_drivers.can_log.frames import Frames
from invid_drivers.eds import load_dictionary, stated

_BLOCK = 1 << 19
"""Frames whose bits are taken apart at once: 64 bytes each."""


_COUNT = 512
_PREDEFINED = 4
"""PDOs whose identifiers CiA 301 gives where a file gives none."""
_DIRECTIONS = (("from_drive", 0x1A00, 0x1800, 0x180), ("to_drive", 0x1600, 0x1400, 0x200))
_DISABLED = 1 << 31
_EXTENDED = 1 << 29
_SIZES = (8, 16, 32, 64)


@dataclass(frozen=True)
class Field:
    """One number in the frames of an identifier: ``bits`` of them from ``start``, value = scale · number +
    offset.

    ``start`` counts from the first byte's lowest bit where it is little-endian, from its highest where
    ``big``.
    """

    name: str
    start: int
    bits: int
    big: bool = False
    kind: str = "uint"
    """uint, int or float."""
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    mux: tuple[Field, frozenset[int]] | None = None
    """Only frames in which this field is one of these numbers hold it."""

    def present(self, frames: Frames) -> Bool:
        """(n,) frames that are long enough and of its group."""
        there: Bool = frames["length"] * 8 >= self.start + self.bits
        if self.mux is not None:
            selector, groups = self.mux
            there &= np.isin(selector.values(frames), list(groups))
        return there

    def values(self, frames: Frames, *, swapped: bool = False) -> Float64:
        """(n,) numbers; ``swapped``: with the bytes the other way round, of whole bytes only."""
        raw = np.concatenate(
            [self._raw(frames.data[i : i + _BLOCK], swapped) for i in range(0, frames["time"].size, _BLOCK)]
            or [np.zeros(0)]
        )
        out: Float64 = raw * self.scale + self.offset
        return out

    def _raw(self, data: np.typing.NDArray[np.uint8], swapped: bool) -> Float64:
        first, stop = self.start // 8, -(-(self.start + self.bits) // 8)
        own = np.zeros((data.shape[0], stop - first), np.uint8)
        own[:, : max(data.shape[1] - first, 0)] = data[:, first:stop]
        own = own[:, ::-1] if swapped else own
        at = self.start - 8 * first
        bits = np.unpackbits(own, axis=1, bitorder="big" if self.big else "little")[:, at : at + self.bits]
        bits = bits[:, ::-1] if self.big else bits
        number = np.zeros(data.shape[0], np.uint64)
        for i in range(self.bits):
            number |= bits[:, i].astype(np.uint64) << np.uint64(i)
        if self.kind == "float":
            return np.asarray(
                number.astype(f"u{self.bits // 8}").view(f"f{self.bits // 8}"), dtype=np.float64
            )
        if self.kind == "int":
            shift = np.uint64(64 - self.bits)
            return np.asarray((number << shift).view(np.int64) >> np.int64(shift), dtype=np.float64)
        return number.astype(np.float64)


def fields_of_pdo(pdo: Pdo, byte_order: str | None) -> list[Field]:
    """The fields of a PDO, one behind the other.

    InputError where they do not fit a frame, or a number of bytes starts inside one.
    """
    fields, at = [], 0
    stated = next((s.byte_order for s in pdo.signals if s.byte_order), None)
    for signal in pdo.signals:
        size = signal.size
        if signal.type != "skip":
            # Half a byte belongs to the order in which the frame counts its bits.
            order = signal.byte_order or (stated if size % 8 else None) or byte_order
            if at % 8 and size % 8 == 0:
                raise InputError(f"map: PDO 0x{pdo.id:X}: {signal.name!r} starts at bit {at}, not at a byte")
            kind = signal.type.rstrip("0123456789")
            fields.append(Field(signal.name, at, size, order == "big" and size > 1, kind))
        at += size
    if at > 512:
        raise InputError(f"map: PDO 0x{pdo.id:X}: its signals take {at} bits; a frame of CAN FD has 512")
    return fields


def fields_of_database(path: Path, identifiers: Collection[int]) -> dict[int, list[Field]]:
    """Identifier → fields ``Message.Signal`` of a database, of the frames that a log holds.

    Raises
    ------
    InputError
        A database that does not parse, or of none of the log's frames.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such database of frames", code="no_file")
    try:
        base: Any = cantools.database.load_file(path, strict=False)
    except Exception as error:  # cantools raises by format: ParseError, UnsupportedDatabaseFormatError, …
        said = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise InputError(
            f"{path}: cannot be read as a database of frames: {said}", code="unreadable"
        ) from None
    found = {}
    for message in getattr(base, "messages", ()):
        if message.frame_id in identifiers:
            plain = {s.name: _field(message.name, s) for s in message.signals}
            found[message.frame_id] = [
                field
                if not s.multiplexer_ids
                else replace(field, mux=(plain[s.multiplexer_signal], frozenset(s.multiplexer_ids)))
                for s, field in zip(message.signals, plain.values(), strict=True)
            ]
    if not found:
        raise InputError(
            f"{path}: describes none of the log's frames; the log has identifiers {listed(identifiers)}",
            code="database_of_another_bus",
        )
    return found


def _field(message: str, signal: Any) -> Field:
    big = signal.byte_order == "big_endian"
    # A DBC numbers the highest bit of a big-endian signal, bytes from their lowest bit.
    start = 8 * (signal.start // 8) + 7 - signal.start % 8 if big else signal.start
    kind = "float" if signal.is_float else "int" if signal.is_signed else "uint"
    scale, offset = float(signal.scale), float(signal.offset)
    return Field(
        f"{message}.{signal.name}", start, signal.length, big, kind, scale, offset, signal.unit or ""
    )


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


def listed(identifiers: Collection[int]) -> str:
    """Identifiers for a message: the first dozen."""
    return ", ".join(f"0x{i:X}" for i in sorted(list(identifiers)[:12])) or "none"
