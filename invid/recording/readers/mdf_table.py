"""Tables from MDF 4 (ASAM measurement data: CANape, INCA, Vector and CSS loggers), through asammdf."""

from __future__ import annotations

import pickle
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from invid.errors import InputError
from invid.numerics.arrays import frozen_float
from invid.recording.tables import Table

TIME_LIMIT = 600.0
"""Seconds; a gigabyte takes one or two minutes."""


def read_mdf_table(path: Path) -> Table:
    """Columns of an MDF file: one clock for each channel group, values physical as the file converts them."""
    if find_spec("asammdf") is None:
        raise InputError(f"{path}: MDF needs the package asammdf; install it with pip install 'invid[mdf]'")
    with tempfile.TemporaryDirectory(prefix="invid-mdf-") as folder:
        out = Path(folder) / "columns"
        command = [sys.executable, "-m", "invid.recording.readers.mdf_process", str(path.resolve()), str(out)]
        try:
            subprocess.run(
                command, check=True, timeout=TIME_LIMIT, capture_output=True, stdin=subprocess.DEVNULL
            )
            with out.open("rb") as stream:
                found = pickle.load(stream)
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: reading it as MDF took more than {TIME_LIMIT:.0f} s") from None
        except (subprocess.CalledProcessError, OSError):
            raise InputError(
                f"{path}: cannot be read as MDF: asammdf broke off on it; it is damaged"
            ) from None
    if found["error"]:
        raise InputError(f"{path}: cannot be read as MDF: {found['error']}")
    if not found["clocks"]:
        raise InputError(f"{path}: holds no channel of real numbers with at least two samples")
    columns = {n: frozen_float(c) for n, c in found["columns"].items()}
    said = ("the file is ASAM MDF",)
    return Table(str(path), columns, units=found["units"], clocks=found["clocks"], reasons=said)
