"""Tables from HDF5 with other names, Parquet, Feather, and NumPy's files.

Arrays become columns: the longest dimension is samples, the other one is counted from 0 in brackets
(``speed[0]``, ``speed[1]``). HDF5 groups are joined by slashes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.import_map import Source
from invid.recording.readers.kinds import limit_numbers
from invid.recording.tables import Table

MAX_WIDTH = 64
"""An array wider than this is no set of channels (an image, a matrix)."""


def channels(name: str, array: Any) -> dict[str, Float64]:
    """Columns of an array, or of the fields of a structured one; none where it is no set of channels."""
    values = np.asarray(array)
    if values.dtype.names:
        parts = [channels(f"{name}.{field}", values[field]) for field in values.dtype.names]
        return {k: v for part in parts for k, v in part.items()}
    if values.dtype.kind not in "iufb" or values.size < 2:
        return {}
    values = np.squeeze(values)
    if values.ndim == 1:
        return {name: frozen_float(values)}
    if values.ndim != 2 or min(values.shape) > MAX_WIDTH:
        return {}
    values = values.T if values.shape[0] < values.shape[1] else values
    return {f"{name}[{i}]": frozen_float(values[:, i]) for i in range(values.shape[1])}


def table_of(
    path: Path,
    columns: Mapping[str, Float64],
    units: Mapping[str, str],
    stamped: frozenset[str] = frozenset(),
) -> Table:
    """The table of these columns; InputError where there are none."""
    if not columns:
        raise InputError(f"{path}: holds no array of real numbers with at least two samples", code="no_data")
    return Table(name=str(path), columns=columns, units=units, stamped=stamped)


def read_numpy(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an array, of its fields, or of an archive of arrays."""
    loaded = np.load(path, allow_pickle=False, mmap_mode=None)
    named = loaded if isinstance(loaded, np.lib.npyio.NpzFile) else {path.stem: loaded}
    columns: dict[str, Float64] = {}
    for name in named:
        columns |= channels(name, named[name])
    return table_of(path, columns, {})


def read_hdf5(path: Path, source: Source, *, beside: Path | None = None) -> Table:
    """Columns of an HDF5 file whatever its names."""
    columns: dict[str, Float64] = {}
    units: dict[str, str] = {}
    with h5py.File(path, "r") as file:
        for name, data in _arrays(file, path).items():
            found = channels(name, data[()])
            columns |= found
            units |= dict.fromkeys(found, unit_of(data)) if unit_of(data) else {}
    return table_of(path, columns, units)


def _arrays(file: h5py.File, path: Path) -> dict[str, h5py.Dataset]:
    """Datasets of numbers that lie in the file itself."""
    found: dict[str, h5py.Dataset] = {}

    def visit(name: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or node.is_virtual or node.external or node.shape is None:
            return
        if (node.dtype.kind in "iuf" or node.dtype.names) and node.ndim <= 3:
            found[name] = node

    file.visititems(visit)
    limit_numbers({n: int(np.prod(d.shape, dtype=object)) for n, d in found.items()}, path)
    return found


def unit_of(data: h5py.Dataset) -> str:
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
    frame = pl.read_ipc(path) if is_feather else pl.read_parquet(path)
    columns: dict[str, Float64] = {}
    units: dict[str, str] = {}
    stamped = set()
    left = list(frame)
    while left:
        column = left.pop(0)
        kind = column.dtype
        if isinstance(kind, pl.Struct):
            left = [s.rename(f"{column.name}.{s.name}") for s in column.struct.unnest()] + left
        elif isinstance(kind, pl.List | pl.Array):
            lengths = column.list.len() if isinstance(kind, pl.List) else pl.Series([kind.size])
            if lengths.n_unique() == 1 and 0 < (size := int(lengths[0] or 0)) <= MAX_WIDTH:
                inside = column.list if isinstance(kind, pl.List) else column.arr
                left = [inside.get(i).rename(f"{column.name}[{i}]") for i in range(size)] + left
        elif kind.is_temporal():
            stamped |= {column.name} if kind != pl.Duration else set()
            columns[column.name], units[column.name] = _seconds(column), "s"
        elif kind.is_numeric() or kind == pl.Boolean:
            columns[column.name] = frozen_float(column.cast(pl.Float64).to_numpy())
    return table_of(path, columns, units, frozenset(stamped))


def _seconds(column: pl.Series) -> Float64:
    if column.dtype == pl.Date:
        column = column.cast(pl.Datetime("us"))
    if column.dtype == pl.Time:
        return frozen_float(column.cast(pl.Int64).cast(pl.Float64).to_numpy() * 1e-9)
    unit = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}[getattr(column.dtype, "time_unit", "us") or "us"]
    return frozen_float(column.to_physical().cast(pl.Float64).to_numpy() * unit)
