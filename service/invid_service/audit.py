"""The audit log: one JSON line for every request that can move a robot, or stop it."""

from __future__ import annotations

import json
import logging
import os
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)


class AuditLog:
    """Append-only file, each line on disk before ``write`` returns."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()

    def write(self, action: str, *, caller: str, **facts: Any) -> None:
        """Append one line; OSError where the disk refuses."""
        line = json.dumps(
            {"time": datetime.now(UTC).isoformat(), "action": action, "caller": caller, **facts},
            ensure_ascii=False,
        )
        with self._lock, self.path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
            file.flush()
            os.fsync(file.fileno())

    def try_write(self, action: str, *, caller: str, **facts: Any) -> None:
        """Append one line, but never wait for a disk or fail with it: for a stop."""
        try:
            self.write(action, caller=caller, **facts)
        except OSError as error:
            log.error("audit: %s by %s could not be written: %s", action, caller, error)

    def tail(self, count: int) -> list[dict[str, Any]]:
        """Return the newest lines, newest last."""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()[-count:]
        except FileNotFoundError:
            return []
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]
