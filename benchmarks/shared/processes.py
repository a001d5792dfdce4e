"""Commands of invid in processes of their own, for the benches that need two of them."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

INVID = [sys.executable, "-c", "from invid.cli import main; main()"]


def start(folder: Path, *arguments: str, errors: str, **environment: str) -> subprocess.Popen[str]:
    """A command in a process of its own, its stderr in a file of the folder."""
    with (folder / errors).open("w") as said:
        return subprocess.Popen(
            [*INVID, *arguments],
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
            cwd=folder,
            env={**os.environ, "XDG_STATE_HOME": str(folder / "state"), **environment},
        )


def wait_for(process: subprocess.Popen[str], path: Path, word: str, seconds: float) -> None:
    """Until a command has said a word on stderr."""
    end = time.monotonic() + seconds
    while word not in path.read_text():
        if process.poll() is not None or time.monotonic() > end:
            raise SystemExit(f"{word!r} was not said: {path.read_text()}")
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    """Process ids of the children; none where the process has gone."""
    try:
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
