"""Tables from MAT v5 and v7.3, HDF5 with other names, and Parquet.

Arrays become columns: the longest dimension is samples, the other one is counted from 0 in brackets
(``speed[0]``, ``speed[1]``). Fields of MATLAB structs are joined by dots, HDF5 groups by slashes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from invid.arrays import Float64, frozen_float
from invid.errors import InputError
from invid.recording.tables import Table

MAX_VALUES = 200_000_000
_MAX_WIDTH = 64
"""An array wider than this is no set of channels (an image, a matrix)."""


def read_mat_table(path: Path) -> Table:
    """Columns of a MAT file of either generation."""
    if h5py.is_hdf5(path):
        return _table(path, _hdf5_arrays(path, separator="."))
    return _table(path, _mat5_arrays(path))


def read_hdf5_table(path: Path) -> Table:
    """Columns of an HDF5 file whatever its names."""
    return _table(path, _hdf5_arrays(path, separator="/"))


def read_parquet_table(path: Path) -> Table:
    """Columns of a Parquet file."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            f"{path}: Parquet needs the package pyarrow; install it with pip install 'invid[parquet]'"
        ) from None
    try:
        file = pyarrow.parquet.ParquetFile(path)
        if file.metadata.num_rows * max(file.metadata.num_columns, 1) > MAX_VALUES:
            raise InputError(f"{path}: more numbers than this program reads from one file")
        table = file.read()
    except InputError:
        raise
    except Exception as error:  # pyarrow raises its own, OSError, ValueError, KeyError by kind of damage
        raise InputError(f"{path}: cannot be read as Parquet: {_first_line(error)}") from None
    columns = {}
    for name in table.column_names:
        values = table.column(name)
        kind = str(values.type)
        if kind.startswith(("int", "uint", "float", "double", "halffloat", "decimal")):
            columns[name] = frozen_float(np.asarray(values.to_numpy(), dtype=np.float64))
        elif kind.startswith("timestamp"):
            columns[name] = frozen_float(values.to_numpy().astype("datetime64[ns]").astype(np.int64) * 1e-9)
    return _finish(path, columns)


def _table(path: Path, arrays: Iterator[tuple[str, Any]]) -> Table:
    columns: dict[str, Float64] = {}
    for name, array in arrays:
        columns.update(_channels(name, array))
    return _finish(path, columns)


def _finish(path: Path, columns: dict[str, Float64]) -> Table:
    if not columns:
        raise InputError(f"{path}: holds no array of real numbers with at least two samples")
    rows = max(c.size for c in columns.values())
    return Table(name=str(path), columns=columns, rows_seen=rows)


def _channels(name: str, array: Any) -> dict[str, Float64]:
    values = np.asarray(array)
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


def _mat5_arrays(path: Path) -> Iterator[tuple[str, Any]]:
    import scipy.io

    try:
        content = scipy.io.loadmat(path, squeeze_me=False, struct_as_record=True)
    except (
        Exception
    ) as error:  # scipy raises ValueError, TypeError, zlib.error, struct.error, … by kind of damage
        raise InputError(f"{path}: cannot be read as a MAT file: {_first_line(error)}") from None
    for name, value in content.items():
        if not name.startswith("__") and name != "None":
            yield from _mat5_fields(name, value, depth=0)


def _mat5_fields(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, np.ndarray) or depth > 6:
        return
    if value.dtype.names:
        if value.size == 1:
            for field in value.dtype.names:
                yield from _mat5_fields(f"{name}.{field}", value.flat[0][field], depth + 1)
        return
    if value.dtype == object and value.size == 1:
        yield from _mat5_fields(name, value.flat[0], depth + 1)
        return
    yield name, value


def _hdf5_arrays(path: Path, separator: str) -> Iterator[tuple[str, Any]]:
    left = MAX_VALUES
    try:
        with h5py.File(path, "r") as file:
            found: list[tuple[str, h5py.Dataset]] = []
            file.visititems(
                lambda name, node: found.append((name, node)) if isinstance(node, h5py.Dataset) else None
            )
            for name, data in found:
                if name.startswith("#") or data.is_virtual or data.external or data.shape is None:
                    continue
                if data.dtype.kind not in "iuf" or data.ndim > 3 or data.attrs.get("MATLAB_class") == b"char":
                    continue
                count = int(np.prod(data.shape, dtype=object))
                if count > left:
                    raise InputError(f"{path}: {name!r} claims {count} numbers, more than this program reads")
                left -= count
                yield name.replace("/", separator), data[()]
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read as HDF5: {_first_line(error)}") from None


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
