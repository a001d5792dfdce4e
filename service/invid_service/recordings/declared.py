"""Look at an uploaded HDF5 file in a process: ``python -m invid_service.recordings.declared FILE``.

Opens the file and adds up the declared sizes, chunk by chunk, decoding nothing; one JSON object on stdout.
Imports next to nothing: it is started for every upload.
"""

from __future__ import annotations

import json
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from invid_service.precedence import as_everyone, behind_parent

_MEMORY = 2 * 1024**3
"""Address space of the process; Python, numpy and HDF5 map half a gigabyte."""
_CPU_S = 20
_NUMBER = 8
"""Bytes of one number once read: everything becomes float64."""
_ELSEWHERE = {
    "problem": "the HDF5 file takes its data from other files (external link, external storage or a virtual "
    "dataset); send one file that holds everything, for example copied with h5repack"
}


def look(path: Path) -> dict[str, Any]:
    """Return the ``unpacked`` bytes that the file claims, or the ``problem`` it has; nothing is unpacked."""
    import h5py  # noqa: PLC0415 - precedence and memory of this process are limited first

    damaged = {"problem": "the HDF5 file is damaged or truncated; copy it again from where it was written"}
    try:
        with h5py.File(path, "r") as file:
            form: Any = file.attrs.get("format")
            form = form.decode("utf-8", "replace") if isinstance(form, bytes) else form
            if form != "invid-recording":
                text = f"the HDF5 file has format {str(form)[:64]!r}, not 'invid-recording'"
                return {"problem": f"{text}; 'invid import' turns other files into one"}
            if isinstance(file.get("experiments", getlink=True), h5py.ExternalLink):
                return _ELSEWHERE
            group = file.get("experiments")
            unpacked = 0
            for node in _members(group):
                if node is None:
                    return _ELSEWHERE
                for data in _members(node):
                    if data is None:
                        return _ELSEWHERE
                    if isinstance(data, h5py.Dataset):
                        if data.is_virtual or data.external:
                            return _ELSEWHERE
                        unpacked += _unpacked(data)
            return {"unpacked": unpacked}
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError):
        return damaged


def _members(group: Any) -> Iterator[Any]:
    """Return what a group holds; ``None`` for what lies in another file, which is not opened."""
    import h5py  # noqa: PLC0415 - as in ``look``

    if not isinstance(group, h5py.Group):
        return
    for name in group:
        found = None
        if not isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            found = group.get(name)  # a soft link may still lead out of the file
        yield found if found is not None and found.file.filename == group.file.filename else None


def _unpacked(data: Any) -> int:
    """Return the bytes that reading takes: whole chunks, which may be larger than what they are said
    to hold.
    """
    shape, chunks = data.shape or (), data.chunks
    whole = [-(-n // c) * c for n, c in zip(shape, chunks, strict=True)] if chunks else shape
    count = 1
    for n in whole:
        count *= int(n)
    return count * max(_NUMBER, int(data.dtype.itemsize))


def main() -> None:
    """Print what a file claims as JSON."""
    as_everyone()
    behind_parent()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    print(json.dumps(look(Path(sys.argv[1]))))


if __name__ == "__main__":
    main()
