"""Tables from MDF 4 (ASAM measurement data: CANape, INCA, Vector and CSS loggers), through asammdf."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

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
        out = Path(folder) / "columns.npz"
        command = [sys.executable, "-m", "invid.recording.readers.mdf_process", str(path.resolve()), str(out)]
        try:
            subprocess.run(
                command, check=True, timeout=TIME_LIMIT, capture_output=True, stdin=subprocess.DEVNULL
            )
            with np.load(out, allow_pickle=False) as found:
                about = json.loads(str(found["about"]))
                columns = {n: frozen_float(found[str(i)]) for i, n in enumerate(about["names"])}
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: reading it as MDF took more than {TIME_LIMIT:.0f} s") from None
        except (subprocess.CalledProcessError, OSError):
            raise InputError(
                f"{path}: cannot be read as MDF: asammdf broke off on it; it is damaged"
            ) from None
    if about["error"]:
        raise InputError(f"{path}: cannot be read as MDF: {about['error']}")
    if not about["clocks"]:
        raise InputError(f"{path}: holds no channel of real numbers with at least two samples")
    return Table(
        str(path), columns, units=about["units"],
        clocks=about["clocks"], reasons=("the file is ASAM MDF",),
    )  # fmt: skip
