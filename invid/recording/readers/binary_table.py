"""Tables from HDF5 with other names, Parquet, Feather, and NumPy's files.

Arrays become columns: the longest dimension is samples, the other one is counted from 0 in brackets
(``speed[0]``, ``speed[1]``). HDF5 groups are joined by slashes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invid.errors import InputError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.tables import Table

MAX_VALUES = 200_000_000
FEATHER = b"ARROW1"
_MAX_WIDTH = 64
"""An array wider than this is no set of channels (an image, a matrix)."""


def read_hdf5_table(path: Path) -> Table:
    """Columns of an HDF5 file whatever its names."""
    return _table(path, _hdf5_arrays(path))


def read_parquet_table(path: Path) -> Table:
    """Columns of a Parquet or a Feather file."""
    try:
        import pyarrow.feather  # noqa: PLC0415 (an extra: not everybody has it)
        import pyarrow.parquet  # noqa: PLC0415 (an extra: not everybody has it)
    except ImportError:
        raise InputError(
            f"{path}: Parquet needs the package pyarrow; install it with pip install 'invid[parquet]'"
        ) from None
    try:
        with path.open("rb") as raw:
            is_feather = raw.read(6) == FEATHER
        if is_feather:
            table = pyarrow.feather.read_table(path)
        else:
            file = pyarrow.parquet.ParquetFile(path)
            if file.metadata.num_rows * max(file.metadata.num_columns, 1) > MAX_VALUES:
                raise InputError(f"{path}: more numbers than this program reads from one file")
            table = file.read()
    except InputError:
        raise
    except Exception as error:  # pyarrow raises its own, OSError, ValueError, KeyError by kind of damage
        raise InputError(f"{path}: cannot be read as Parquet: {first_line(error)}") from None
    columns, units = {}, {}
    while any(pyarrow.types.is_struct(kind) for kind in table.schema.types):
        table = table.flatten()
    for name in table.column_names:
        values = table.column(name)
        kind = str(values.type)
        if pyarrow.types.is_list(values.type) or pyarrow.types.is_fixed_size_list(values.type):
            lengths = set(values.combine_chunks().value_lengths().to_pylist())
            if len(lengths) == 1 and None not in lengths:
                entries = np.asarray(values.combine_chunks().flatten())
                columns.update(channels(name, entries.reshape(len(values), -1)))
        if kind.startswith(("int", "uint", "float", "double", "halffloat", "decimal")):
            columns[name] = frozen_float(np.asarray(values.to_numpy(), dtype=np.float64))
        elif kind.startswith(("timestamp", "duration")):
            known = "datetime64[ns]" if kind.startswith("timestamp") else "timedelta64[ns]"
            instants = values.to_numpy().astype(known)
            seconds = instants.astype(np.int64) * 1e-9
            seconds[np.isnat(instants)] = np.nan
            columns[name], units[name] = frozen_float(seconds), "s"
    stamped = frozenset(n for n in units if str(table.column(n).type).startswith("timestamp"))
    return finish(path, columns, units, stamped)


def _table(path: Path, arrays: Iterator[tuple[str, Any, str]]) -> Table:
    columns: dict[str, Float64] = {}
    units: dict[str, str] = {}
    for name, array, unit in arrays:
        found = channels(name, array)
        columns.update(found)
        units.update(dict.fromkeys(found, unit) if unit else {})
    return finish(path, columns, units)


def finish(
    path: Path, columns: dict[str, Float64], units: dict[str, str], stamped: frozenset[str] = frozenset()
) -> Table:
    """The table of these columns; InputError where there are none."""
    if not columns:
        raise InputError(f"{path}: holds no array of real numbers with at least two samples")
    return Table(name=str(path), columns=columns, units=units, stamped=stamped)


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
    if values.ndim != 2 or min(values.shape) > _MAX_WIDTH:
        return {}
    if values.shape[0] < values.shape[1]:
        values = values.T
    return {f"{name}[{i}]": frozen_float(values[:, i]) for i in range(values.shape[1])}


def _hdf5_arrays(path: Path) -> Iterator[tuple[str, Any, str]]:
    left = MAX_VALUES
    try:
        with h5py.File(path, "r") as file:
            found: list[tuple[str, h5py.Dataset]] = []
            file.visititems(
                lambda name, node: found.append((name, node)) if isinstance(node, h5py.Dataset) else None
            )
            for name, data in found:
                if data.is_virtual or data.external or data.shape is None:
                    continue
                numbers = data.dtype.kind in "iuf" or bool(data.dtype.names)
                if not numbers or data.ndim > 3:
                    continue
                count = int(np.prod(data.shape, dtype=object))
                if count > left:
                    raise InputError(f"{path}: {name!r} claims {count} numbers, more than this program reads")
                left -= count
                yield name, data[()], unit_of(data)
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read as HDF5: {first_line(error)}") from None


def unit_of(data: h5py.Dataset) -> str:
    """The attribute ``unit`` or ``units`` of a dataset; empty where it has none."""
    for name in ("unit", "units", "Unit", "Units"):
        try:
            value = data.attrs.get(name)
        except (OSError, TypeError, ValueError, KeyError, RuntimeError):
            continue
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str):
            return value.strip()
    return ""


def first_line(error: BaseException) -> str:
    """What an error of a library says first, for a message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
