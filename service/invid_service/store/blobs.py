"""Store files beside the database: written under a temporary name, renamed, checksummed."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from invid.recording.spool import sync_folder

KINDS: dict[str, tuple[str, str]] = {
    "recording": ("recording.h5", "application/x-hdf5"),
    "model": ("model.json", "application/json"),
    "diagnosis": ("diagnosis.json", "application/json"),
    "report": ("report.html", "text/html; charset=utf-8"),
    "plots": ("plots.json", "application/json"),
    "tuning": ("tuning.json", "application/json"),
    "tuning-page": ("tuning.html", "text/html; charset=utf-8"),
    "tuning-picture": ("tuning.svg", "image/svg+xml"),
    "tuning-files": ("tuning.zip", "application/zip"),
    "verification": ("verification.json", "application/json"),
    "verification-picture": ("verification.svg", "image/svg+xml"),
}
"""kind -> (file name, media type)."""


@dataclass(frozen=True)
class Blob:
    """A stored file."""

    path: str
    size: int
    sha256: str


class Blobs:
    """Files under ``root``, one folder per run."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.work = root.parent / "work"
        for folder in (self.root, self.work):
            folder.mkdir(parents=True, exist_ok=True)

    def scratch(self, run: str) -> Path:
        """Make a folder for a run to work in."""
        folder = self.work / run
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @contextlib.contextmanager
    def filling(self, run: str) -> Iterator[Path]:
        """Context manager with such a folder, which is gone again where what is done within fails."""
        try:
            yield self.scratch(run)
        except BaseException:
            self.clear_scratch(run)
            raise

    def put(self, run: str, kind: str, source: Path) -> Blob | None:
        """Move ``source`` into the store: flushed, then renamed, so that no half file has its name.

        Where it is not there (any more), what an earlier try moved; ``None`` where there is neither.
        """
        target = self.root / run / KINDS[kind][0]
        if not (source.is_file() and source.stat().st_size > 0):
            return self._blob(target) if target.is_file() else None
        target.parent.mkdir(parents=True, exist_ok=True)
        with source.open("rb") as file:
            os.fsync(file.fileno())
        if source.stat().st_dev == target.parent.stat().st_dev:
            source.replace(target)
        else:
            part = target.with_name(target.name + ".part")
            shutil.copyfile(source, part)
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(target)
            source.unlink()
        sync_folder(target.parent)
        return self._blob(target)

    def _blob(self, target: Path) -> Blob:
        with target.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return Blob(str(target.relative_to(self.root)), target.stat().st_size, digest)

    def path(self, relative: str) -> Path:
        """Return the file of a stored path; ValueError where it would lie outside the store."""
        path = (self.root / relative).resolve()
        if not path.is_relative_to(self.root.resolve()):
            raise ValueError(f"{relative!r} lies outside the store")
        return path

    def clear_scratch(self, run: str) -> None:
        """Delete a run's working folder."""
        shutil.rmtree(self.work / run, ignore_errors=True)

    def free_bytes(self) -> int:
        """Return the bytes left on the disk."""
        return shutil.disk_usage(self.root).free
