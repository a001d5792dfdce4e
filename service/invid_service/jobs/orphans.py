"""Wait for runners that outlive their service: no run may start while one may still move its robot."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import signal
import time
from pathlib import Path
from typing import IO

log = logging.getLogger(__name__)
_NAME = "runner.pid"


def hold(folder: Path) -> IO[str]:
    """Lock the data folder for a runner; the lock lasts as long as its process, however that ends."""
    file = (folder / _NAME).open("w")
    fcntl.flock(file, fcntl.LOCK_EX)
    file.write(str(os.getpid()))
    file.flush()
    return file


def settle(work: Path, grace_s: float) -> None:
    """Wait until every runner of the last service has stopped its drives and ended; kill what hangs.

    A runner stops by itself when the pipe to its service breaks; killed, it leaves its drives without the
    master's heartbeat, and they stop by themselves.
    """
    deadline = time.monotonic() + grace_s
    for path in sorted(work.glob(f"*/{_NAME}")):
        while not _ended(path):
            if time.monotonic() > deadline:
                _kill(path)
                deadline = time.monotonic() + 2.0
            time.sleep(0.05)


def _ended(path: Path) -> bool:
    try:
        with path.open("r") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True


def _kill(path: Path) -> None:
    # The lock is held, so the number in the file is that of a living runner, not a later process's.
    with contextlib.suppress(OSError, ValueError):
        pid = int(path.read_text())
        log.error("runner %d of the last service did not end and is killed", pid)
        os.kill(pid, signal.SIGKILL)
