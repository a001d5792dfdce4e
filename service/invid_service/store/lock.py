"""Let one service at a time use a data folder."""

from __future__ import annotations

import fcntl
from pathlib import Path

from invid.errors import ConfigError


class DataLock:
    """Lock of a data folder; the kernel gives it back however the process ends."""

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = (folder / "service.lock").open("a")
        except OSError as error:
            raise ConfigError(
                f"data folder {folder}: cannot be written ({error.strerror or error}); give --data-dir"
            ) from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise ConfigError(
                f"data folder {folder}: another invid service is using it; stop that one or give --data-dir"
            ) from None

    def release(self) -> None:
        """Let another service in."""
        self._file.close()
