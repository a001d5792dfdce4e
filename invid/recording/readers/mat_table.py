"""Tables from MAT files of either generation by pymatreader: structs, struct arrays and cells by their names.

Fields are joined by dots. An entry of a cell or of a struct array goes by its ``label`` or ``Name``, else by
its place from 0 in brackets. A struct's ``time`` is the clock of what lies in it and is as long.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from pymatreader import read_mat as read_contents
from scipy.io.matlab import MatlabFunction, MatlabOpaque

from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.readers.arrays import Columns, read_hdf5
from invid.recording.readers.kinds import limit_numbers
from invid.recording.tables import Table

_MANY = 64
"""Entries of a struct array up to which each is a signal of its own; beyond, each is a sample."""
_TIME = re.compile(r"(time|t|timestamps?|tout)$", re.IGNORECASE)
_LABELS = ("label", "Label", "Name", "name", "signalName", "SignalName")
_WAYS = {
    "timeseries": "s = struct('Time', {0}.Time, 'Data', {0}.Data)",
    "table": "s = table2struct({0}, 'ToScalar', true)",
    "timetable": "s = table2struct(timetable2table({0}), 'ToScalar', true)",
    "datetime": "s = posixtime({0})",
    "duration": "s = seconds({0})",
}
_OBJECT = "{0!r} is a MATLAB object of class {1}, which only MATLAB reads: there, {2}; save(file, 's')"


class _Found(Columns):
    """Columns by the names of structs and cells, which have names by place as well."""

    def take(self, name: str, places: Sequence[str], values: Any, clocks: Sequence[str]) -> None:
        """Columns of an array; its clock is the nearest one that is as long."""
        for column, own in self.add(name, values).items():
            rest = column.removeprefix(name)
            self.aliases.update({p + rest: column for p in places if p + rest != column})
            near = [c for c in clocks if c in self.values and self.values[c].size == own.size]
            if near and column not in clocks:
                self.clocks[column] = near[-1]

    def walk(self, name: str, places: list[str], value: Any, clocks: tuple[str, ...]) -> None:
        """All columns below a value, named by ``name``; ``places`` are the names it has by place."""
        if isinstance(value, dict) and (many := _entries(value)) is not None:
            value = many
        if isinstance(value, dict):
            times = [k for k, v in value.items() if _TIME.match(k) and isinstance(v, np.ndarray)]
            for key in times:
                self.take(f"{name}.{key}", [f"{p}.{key}" for p in places], value[key], ())
            inside = (*clocks, *(f"{name}.{key}" for key in times))
            for key in (k for k in value if k not in times):
                self.walk(f"{name}.{key}", [f"{p}.{key}" for p in places], value[key], inside)
        elif isinstance(value, list) and (len(value) > _MANY or not any(map(_holds_arrays, value))):
            keys = value[0] if value and isinstance(value[0], dict) else {"": None}
            for key in keys:
                cells = [e.get(key) if isinstance(e, dict) else e for e in value]
                if all(isinstance(c, int | float) for c in cells):
                    at = f"{name}.{key}" if key else name
                    self.take(at, [at], np.array(cells, dtype=np.float64), clocks)
        elif isinstance(value, list):
            labels = _labels(value)
            for i, entry in enumerate(value):
                own = f"{name}.{labels[i]}" if labels else f"{name}[{i}]"
                self.walk(own, [f"{p}[{i}]" for p in places], entry, clocks)
                # As a table of the field over the entries, too.
                for key in entry if isinstance(entry, dict) else ():
                    self.aliases.update({f"{p}.{key}[{i}]": f"{own}.{key}" for p in places})
        else:
            self.take(name, places, value, clocks)


def _entries(struct: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    """The entries of a struct array, which pymatreader gives as a dict of lists alike in length."""
    sizes = {len(v) if isinstance(v, list) else -1 for v in struct.values()}
    if len(sizes) != 1 or min(sizes) < 2:
        return None
    return [dict(zip(struct, row, strict=True)) for row in zip(*struct.values(), strict=True)]


def _labels(entries: Sequence[Any]) -> list[str]:
    """A name for each entry that the file gives; none where some have none or two have one."""
    said = [
        next((e[k] for k in _LABELS if isinstance(e.get(k), str)), "") for e in entries if isinstance(e, dict)
    ]
    return said if all(said) and len(set(said)) == len(entries) else []


def _holds_arrays(entry: Any) -> bool:
    values = entry.values() if isinstance(entry, dict) else [entry]
    return any(isinstance(v, dict | list | np.ndarray) for v in values)


def read_mat(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a MAT file of either generation."""
    with path.open("rb") as raw:
        if raw.read(6) != b"MATLAB" and h5py.is_hdf5(path):
            return read_hdf5(path, source)  # Octave's
    objects, names = _contents(path)
    found = _Found()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is no number is told by its class
        content = read_contents(path, variable_names=names) if names else {}
    for name in names:
        found.walk(name, [name], content.get(name), ())
    refused = [_OBJECT.format(n, k, _WAYS.get(k, "s = struct({0})").format(n)) for n, k in objects.items()]
    if refused and not found.values:
        said = "; ".join([f"{path}: holds no array of real numbers with at least two samples", *refused[:3]])
        raise InputError(said, code="matlab_object")
    return found.table(path, reasons=tuple(refused))


def _contents(path: Path) -> tuple[dict[str, str], list[str]]:
    """Objects by name with their class, and the names of what is none."""
    if not h5py.is_hdf5(path):
        loaded = scipy.io.loadmat(path)
        opaque = [np.ravel(np.asarray(v))[0] for v in loaded.values() if isinstance(v, MatlabOpaque)]
        objects = {_text(row[0]): _text(row[2]) for row in opaque}
        plain = (n for n, v in loaded.items() if not isinstance(v, MatlabOpaque | MatlabFunction))
        return objects, [n for n in plain if not n.startswith("__")]
    with h5py.File(path, "r") as file:
        own = [
            n for n in file if not n.startswith("#") and isinstance(file.get(n, getlink=True), h5py.HardLink)
        ]
        inside: dict[str, Any] = {}
        file.visititems(inside.__setitem__)
        arrays = {n: d for n, d in inside.items() if isinstance(d, h5py.Dataset) and d.shape is not None}
        limit_numbers({n: int(np.prod(d.shape, dtype=object)) for n, d in arrays.items()}, path)
        objects = {
            n: _text(d.attrs.get("MATLAB_class", b"unknown"))
            for n, d in inside.items()
            if "MATLAB_object_decode" in d.attrs or _is_handle(d)
        }
        elsewhere = {n.split("/")[0] for n, d in arrays.items() if d.is_virtual or d.external}
        return objects, [n for n in own if n not in objects and n not in elsewhere]


def _is_handle(node: Any) -> bool:
    """Whether a dataset is the six numbers that stand for an object, whose content is in no open form."""
    return (
        isinstance(node, h5py.Dataset)
        and node.dtype == np.uint32
        and node.shape is not None
        and 6 <= node.size < 100
        and int(node[()].flat[0]) == 0xDD000000
    )


def _text(value: Any) -> str:
    return value.decode("latin-1") if isinstance(value, bytes) else str(value)
