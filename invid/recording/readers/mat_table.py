"""Tables from MAT files of either generation, v5 and v7.3: structs, struct arrays and cells by their names.

Fields are joined by dots. An entry of a cell or of a struct array goes by its ``label`` or ``Name``, else by
its place from 0 in brackets. A struct's ``time`` is the clock of what lies in it and is as long.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from invid.errors import InputError
from invid.numerics.arrays import Float64
from invid.recording.readers.binary_table import MAX_VALUES, channels, first_line, unit_of
from invid.recording.tables import Table, each_once

_DEPTH = 8
_MANY = 64
"""Entries of a struct array up to which each is a signal of its own; beyond, each is a sample."""
_MOST_NODES = 20_000
_TIME = re.compile(r"(time|t|timestamps?|tout)$", re.IGNORECASE)
_LABELS = ("label", "Label", "Name", "name", "signalName", "SignalName")
_HANDLE = 0xDD000000
"""First number of the six that stand for an object in v7.3; its content lies elsewhere, in no open form."""


@dataclass(frozen=True, eq=False)
class _Numbers:
    values: Any
    unit: str = ""


@dataclass(frozen=True)
class _Object:
    """A MATLAB object: only MATLAB reads it."""

    kind: str


@dataclass
class _Found:
    columns: dict[str, Float64] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    objects: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, places: Sequence[str], numbers: _Numbers, clocks: Sequence[str]) -> None:
        """Columns of an array; its clock is the nearest one that is as long."""
        new = channels(name, numbers.values)
        self.columns |= new
        self.units |= dict.fromkeys(new, numbers.unit) if numbers.unit else {}
        for column, values in new.items():
            rest = column.removeprefix(name)
            self.aliases |= {p + rest: column for p in places if p + rest != column}
            near = [c for c in clocks if c in self.columns and self.columns[c].size == values.size]
            if near and column not in clocks:
                self.clocks[column] = near[-1]


def read_mat_table(path: Path) -> Table:
    """Columns of a MAT file of either generation."""
    content = _hdf5(path) if h5py.is_hdf5(path) else _mat5(path)
    found = _Found()
    for name, value in content.items():
        _walk(found, name, [name], value, ())
    objects = [_refusal(n, k) for n, k in found.objects.items()]
    if not found.columns:
        raise InputError(
            f"{path}: holds no array of real numbers with at least two samples"
            + "".join(f"; {o}" for o in objects[:3])
        )
    return Table(
        name=str(path), columns=found.columns, units=found.units, aliases=found.aliases,
        clocks=each_once(found.clocks, found.columns), reasons=tuple(objects),
    )  # fmt: skip


def _refusal(name: str, kind: str) -> str:
    way = {
        "timeseries": f"s = struct('Time', {name}.Time, 'Data', {name}.Data)",
        "table": f"s = table2struct({name}, 'ToScalar', true)",
        "timetable": f"s = table2struct(timetable2table({name}), 'ToScalar', true)",
        "datetime": f"s = posixtime({name})",
        "duration": f"s = seconds({name})",
    }.get(kind, f"s = struct({name})")
    return (
        f"{name!r} is a MATLAB object of class {kind}, which only MATLAB reads: there, {way}; save(file, 's')"
    )


def _walk(found: _Found, name: str, places: list[str], value: Any, clocks: tuple[str, ...]) -> None:
    """All columns below a value, named by ``name``; ``places`` are the names it has by place."""
    match value:
        case _Object(kind):
            found.objects[name] = kind
        case _Numbers():
            found.add(name, places, value, clocks)
        case dict():
            times = [k for k, v in value.items() if _TIME.match(k) and isinstance(v, _Numbers)]
            for key in times:
                found.add(f"{name}.{key}", [f"{p}.{key}" for p in places], value[key], ())
            inside = (*clocks, *(f"{name}.{key}" for key in times))
            for key, entry in value.items():
                if key not in times:
                    _walk(found, f"{name}.{key}", [f"{p}.{key}" for p in places], entry, inside)
        case list() if len(value) > _MANY or not any(map(_holds_arrays, value)):
            for key, column in _by_sample(value).items():
                at = f"{name}.{key}" if key else name
                found.add(at, [at], _Numbers(column), clocks)
        case list():
            labels = _labels(value)
            for i, entry in enumerate(value):
                own = f"{name}.{labels[i]}" if labels else f"{name}[{i}]"
                _walk(found, own, [f"{p}[{i}]" for p in places], entry, clocks)
                # As a table of the field over the entries, too.
                for key in entry if isinstance(entry, dict) else ():
                    found.aliases |= {f"{p}.{key}[{i}]": f"{own}.{key}" for p in places}


def _labels(entries: Sequence[Any]) -> list[str]:
    """A name for each entry that the file gives; none where some have none or two have one."""
    said = [
        next((e[k] for k in _LABELS if isinstance(e.get(k), str) and e[k].strip()), "")
        if isinstance(e, dict)
        else ""
        for e in entries
    ]
    return said if all(said) and len(set(said)) == len(said) else []


def _holds_arrays(entry: Any) -> bool:
    values = entry.values() if isinstance(entry, dict) else [entry]
    return any(
        isinstance(v, dict | list) or (isinstance(v, _Numbers) and np.size(v.values) > 1) for v in values
    )


def _by_sample(entries: Sequence[Any]) -> dict[str, Float64]:
    """Columns of a struct array (or cells) with one entry a sample: fields that are one number throughout."""
    keys: Mapping[str, Any] = entries[0] if isinstance(entries[0], dict) else {"": None}
    out = {}
    for key in keys:
        cells = [(e.get(key) if isinstance(e, dict) else e) for e in entries]
        if all(isinstance(c, _Numbers) and np.size(c.values) == 1 for c in cells):
            out[key] = np.array([float(np.ravel(c.values)[0]) for c in cells if isinstance(c, _Numbers)])
    return out


def _mat5(path: Path) -> dict[str, Any]:
    try:
        content = scipy.io.loadmat(path, squeeze_me=False, struct_as_record=True)
    except Exception as error:  # scipy raises ValueError, TypeError, zlib.error, struct.error, … by damage
        raise InputError(f"{path}: cannot be read as a MAT file: {first_line(error)}") from None
    out: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, MatlabOpaque):
            for row in np.ravel(np.asarray(value)):
                own, kind = (_text(row[k]) for k in ("s0", "s2"))
                out[own or name] = _Object(kind)
        elif not name.startswith("__"):
            out[name] = _mat5_value(value, 0)
    return out


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)


def _alone(entries: list[Any]) -> Any:
    """The one entry of a cell or struct array of one, else the entries."""
    return entries[0] if len(entries) == 1 else entries


def _mat5_value(value: Any, depth: int) -> Any:
    if not isinstance(value, np.ndarray) or depth > _DEPTH or isinstance(value, MatlabFunction):
        return None
    if isinstance(value, MatlabOpaque):
        return _Object(_text(np.ravel(np.asarray(value))[0]["s2"]))
    if value.dtype.names:
        fields = value.dtype.names
        return _alone([{f: _mat5_value(row[f], depth + 1) for f in fields} for row in value.flat])
    if value.dtype == object:
        return _alone([_mat5_value(cell, depth + 1) for cell in value.flat])
    if value.dtype.kind in "US":
        return str(value.flat[0]) if value.size == 1 else None
    return _Numbers(value)


def _hdf5(path: Path) -> dict[str, Any]:
    try:
        with h5py.File(path, "r") as file:
            reading = _Hdf5(file, path)
            return {n: reading.value(file, n, 0) for n in file if not n.startswith("#")}
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read as a MAT file: {first_line(error)}") from None


@dataclass
class _Hdf5:
    """A v7.3 file while it is read; cells and struct arrays hold references."""

    file: h5py.File
    path: Path
    left: int = MAX_VALUES
    nodes: int = 0

    def value(self, group: h5py.Group, name: str, depth: int) -> Any:
        """What stands under a name; links to other places or files are not followed."""
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return None
        return self.node(group[name], depth)

    def node(self, node: Any, depth: int) -> Any:
        """A struct as a dict, a cell or struct array as a list, text, numbers; None for anything else."""
        self.nodes += 1
        if depth > _DEPTH or self.nodes > _MOST_NODES:
            return None
        if isinstance(node, h5py.Group):
            if "MATLAB_object_decode" in node.attrs:
                return _Object(_text(node.attrs.get("MATLAB_class", b"unknown")))
            fields = {n: self.value(node, n, depth + 1) for n in node}
            return _struct_array(node, fields)
        if node.is_virtual or node.external or node.shape is None:
            return None
        kind = _text(node.attrs.get("MATLAB_class", b""))
        if node.dtype == h5py.ref_dtype:
            if node.size > MAX_VALUES // 100:
                return None
            return _alone([self.node(self.file[r], depth + 1) for r in node[()].ravel() if r])
        if node.dtype.kind in "iufb" or node.dtype.names:
            return self._numbers(node, kind)
        return None

    def _numbers(self, node: h5py.Dataset, kind: str) -> Any:
        if "MATLAB_object_decode" in node.attrs or (
            node.dtype == np.uint32 and node.size >= 6 and node.ndim <= 2 and node[()].flat[0] == _HANDLE
        ):
            return _Object(kind or "unknown")
        if node.ndim > 3 or "MATLAB_empty" in node.attrs:
            return None
        if kind == "char":
            return "".join(map(chr, node[()].ravel())) if node.size < 1000 else None
        count = int(np.prod(node.shape, dtype=object))
        if count > self.left:
            raise InputError(
                f"{self.path}: {node.name!r} claims {count} numbers, more than this program reads"
            )
        self.left -= count
        return _Numbers(node[()], unit_of(node))


def _struct_array(group: h5py.Group, fields: dict[str, Any]) -> Any:
    """One struct, or the entries of a struct array, whose fields are lists of references alike in length."""
    lists = {
        n: v
        for n, v in fields.items()
        if isinstance(v, list) and "MATLAB_class" not in group[n].attrs and len(v) > 1
    }
    if not lists or len(lists) != len(fields) or len({len(v) for v in lists.values()}) != 1:
        return fields
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
