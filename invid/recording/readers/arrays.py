"""Columns of arrays, whatever file they come from; HDF5 with other names, Parquet, Feather, NumPy's files.

Arrays become columns: the longest dimension is samples, the other one is counted from 0 in brackets
(``speed[0]``, ``speed[1]``). HDF5 groups are joined by slashes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.kinds import limit_numbers
from invid.recording.tables import Table, each_once

MAX_WIDTH = 64
"""An array wider than this is no set of channels (an image, a matrix)."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a file, as a reader finds them: see ``Table``."""

    values: dict[str, Float64] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    stamped: set[str] = field(default_factory=set)

    def add(self, name: str, array: Any, unit: str = "", clock: str = "") -> dict[str, Float64]:
        """Take an array, or the fields of a structured one; what became columns, none of what is no channels.

        Dates are seconds since 1970.
        """
        values = np.asarray(array)
        if values.dtype.names:
            parts = [self.add(f"{name}.{n}", values[n], unit, clock) for n in values.dtype.names]
            return {n: v for part in parts for n, v in part.items()}
        if values.dtype.kind in "mM":
            self.stamped.update([name] * (values.dtype.kind == "M"))
            zero = np.datetime64(0, "s") if values.dtype.kind == "M" else np.timedelta64(0, "s")
            values, unit = (values - zero) / np.timedelta64(1, "s"), "s"
        if values.dtype.kind not in "iufb" or values.size < 2:
            return {}
        values = np.squeeze(values)
        found = {name: frozen_float(values)} if values.ndim == 1 else {}
        if values.ndim == 2 and min(values.shape) <= MAX_WIDTH:
            turned = values.T if values.shape[0] < values.shape[1] else values
            found = {f"{name}[{i}]": frozen_float(column) for i, column in enumerate(turned.T)}
        self.values.update(found)
        self.units.update(dict.fromkeys(found, unit) if unit else {})
        self.clocks.update(dict.fromkeys(found, clock) if clock else {})
        return found

    def table(self, path: Path, **more: Any) -> Table:
        """The table of these columns with ``more`` of its fields; InputError where there are none."""
        if not self.values:
            raise InputError(
                f"{path}: holds no array of real numbers with at least two samples", code="no_data"
            )
        return Table(
            str(path), self.values, units=self.units, clocks=each_once(self.clocks, self.values),
            aliases=self.aliases, stamped=frozenset(self.stamped), **more,
        )  # fmt: skip


def read_numpy(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an array, of its fields, or of an archive of arrays."""
    loaded = np.load(path, allow_pickle=False, mmap_mode=None)
    named: Mapping[str, Any] = loaded if isinstance(loaded, np.lib.npyio.NpzFile) else {path.stem: loaded}
    found = Columns()
    for name in named:
        found.add(name, named[name])
    return found.table(path)


def read_hdf5(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an HDF5 file whatever its names, of the datasets of numbers that lie in the file itself."""
    found, inside = Columns(), dict[str, Any]()
    with h5py.File(path, "r") as file:
        file.visititems(inside.__setitem__)
        own = {
            name: node
            for name, node in inside.items()
            if isinstance(node, h5py.Dataset)
            and not (node.is_virtual or node.external or node.shape is None or node.ndim > 3)
            and (node.dtype.kind in "iuf" or node.dtype.names)
        }
        limit_numbers({n: int(np.prod(d.shape, dtype=object)) for n, d in own.items()}, path)
        for name, data in own.items():
            found.add(name, data[()], _unit_of(data))
    return found.table(path)


def _unit_of(data: h5py.Dataset) -> str:
    """The attribute ``unit`` or ``units`` of a dataset; empty where it has none."""
    for name in ("unit", "units", "Unit", "Units"):
        try:
            value = data.attrs.get(name)
        except (OSError, TypeError, ValueError, KeyError, RuntimeError):
            continue
        value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if isinstance(value, str):
            return value.strip()
    return ""


def read_parquet(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of a Parquet or a Feather file; structs and lists of one length as columns of their own."""
    with path.open("rb") as raw:
        is_feather = raw.read(6) == b"ARROW1"
    left, found = list(pl.read_ipc(path) if is_feather else pl.read_parquet(path)), Columns()
    while left:
        column = left.pop(0)
        kind = column.dtype
        if isinstance(kind, pl.Struct):
            left = [s.rename(f"{column.name}.{s.name}") for s in column.struct.unnest()] + left
        elif isinstance(kind, pl.List | pl.Array):
            lists = column.cast(pl.List(kind.inner)).list
            if lists.len().n_unique() == 1 and 0 < (size := int(lists.len()[0] or 0)) <= MAX_WIDTH:
                left = [lists.get(i).rename(f"{column.name}[{i}]") for i in range(size)] + left
        elif kind.is_temporal():
            found.add(column.name, column.cast(pl.Duration("ns") if kind == pl.Time else kind).to_numpy())
            found.stamped.update([column.name] * (kind == pl.Time))
        elif kind.is_numeric() or kind == pl.Boolean:
            found.add(column.name, column.cast(pl.Float64).to_numpy())
    return found.table(path)
