"""The process that looks at an uploaded HDF5 file: ``python -m invid_service.recordings.declared FILE``.

Opens the file and adds up the declared sizes, chunk by chunk, decoding nothing; one JSON object on stdout.
Imports next to nothing: it is started for every upload.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

_MEMORY = 2 * 1024**3
"""Address space of the process; Python, numpy and HDF5 map half a gigabyte."""
_CPU_S = 20
_NUMBER = 8
"""Bytes of one number once read: everything becomes float64."""


def look(path: Path) -> dict[str, Any]:
    """``unpacked`` bytes that the file claims, or the ``problem`` it has; nothing in it is unpacked."""
    import h5py

    damaged = {"problem": "the HDF5 file is damaged or truncated; copy it again from where it was written"}
    try:
        with h5py.File(path, "r") as file:
            form: Any = file.attrs.get("format")
            form = form.decode("utf-8", "replace") if isinstance(form, bytes) else form
            if form != "invid-recording":
                text = f"the HDF5 file has format {str(form)[:64]!r}, not 'invid-recording'"
                return {"problem": f"{text}; 'invid import' turns other files into one"}
            group = file.get("experiments")
            unpacked = 0
            for node in group.values() if isinstance(group, h5py.Group) else ():
                if isinstance(node, h5py.Group):
                    unpacked += sum(_unpacked(d) for d in node.values() if isinstance(d, h5py.Dataset))
            return {"unpacked": unpacked}
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError):
        return damaged


def _unpacked(data: Any) -> int:
    """Bytes that reading takes: whole chunks, which may be larger than what they are said to hold."""
    shape, chunks = data.shape or (), data.chunks
    whole = [-(-n // c) * c for n, c in zip(shape, chunks, strict=True)] if chunks else shape
    count = 1
    for n in whole:
        count *= int(n)
    return count * max(_NUMBER, int(data.dtype.itemsize))


def main() -> None:
    """Entry of the process."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    print(json.dumps(look(Path(sys.argv[1]))))


if __name__ == "__main__":
    main()
