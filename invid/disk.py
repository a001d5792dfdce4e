"""Say of a file that was not written why, what room its disk has left, and the way out."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

from invid.errors import DiskFullError, InputError

MEBIBYTE = 1 << 20
_FULL = {errno.ENOSPC, errno.EDQUOT}
WAY_OUT = "make room there, or write to another disk"


def is_full(error: OSError) -> bool:
    """True where a disk, or the share of it that this user has, is full."""
    return error.errno in _FULL


def free(folder: Path) -> str:
    """Return in words what is free on the disk of a folder."""
    return f"{shutil.disk_usage(folder).free / MEBIBYTE:.1f} MiB are free"


def room(folder: Path) -> str:
    """Return in words what is free on the disk of a folder, or of the nearest one above that exists, and
    where.
    """
    folder = folder.absolute()
    there = next((f for f in (folder, *folder.parents) if f.is_dir()), Path("/"))
    return f"{free(there)} in {there}"


def not_written(
    path: Path, error: OSError, *, kept: str = "", otherwise: type[InputError] = InputError
) -> InputError:
    """Return the error of a file that was not written: DiskFullError with the room and the way out, else
    ``otherwise``.

    ``kept`` says what is safe all the same.
    """
    also = f"; {kept}" if kept else ""
    reason = error.strerror or str(error)
    if not is_full(error):
        return otherwise(f"{path}: cannot be written: {reason}{also}")
    return DiskFullError(f"{path}: cannot be written: {reason}, {room(path.parent)}{also}", way_out=WAY_OUT)
