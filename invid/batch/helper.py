"""Run a process that analyses one recording after the other, for a thread that asks it.

A file that crashes a library, or for which memory lacks, then costs a row and not the batch. The process
reads a task a line (JSON) and answers with a line; when its stdin closes, whoever asked is gone: it ends.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict
from pathlib import Path
from typing import Any

from invid.batch.analysis import KILLED, Options, Outcome, analyse_recording

ATTEMPTS = 2
"""Of a recording whose process dies: once may have been the system's doing, twice is the recording's."""


class Helper:
    """Process that analyses recordings, started when it is first asked and again after it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def ask(self, path: Path, name: str, options: Options) -> Outcome:
        """Return the outcome of a recording; where the process died on every attempt, one that says so."""
        status = 0
        for _ in range(ATTEMPTS):
            if self._closed:
                break
            answer, status = self._exchange({"path": str(path), "name": name, "options": options.to_json()})
            if answer is not None:
                return answer
        how = f"by signal {-status}" if status < 0 else f"with status {status}"
        text = f"its process ended {how} on {ATTEMPTS} attempts (is there memory enough? try fewer --workers)"
        return Outcome(name, "failed", KILLED, error=text)

    def _exchange(self, task: dict[str, Any]) -> tuple[Outcome | None, int]:
        process = self._running()
        if process.stdin is None or process.stdout is None:
            raise RuntimeError("the helper has no pipes")
        try:
            process.stdin.write(json.dumps(task).encode() + b"\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            line = b""
        if line.endswith(b"\n"):
            return Outcome(**json.loads(line)), 0
        process.stdin.close()
        process.stdout.close()
        status = process.wait()
        self._process = None
        return None, status

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for the one who asks
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        if self._closed:  # meanwhile
            self._process.kill()
        return self._process

    def close(self) -> None:
        """End the process, in the middle of a recording too."""
        self._closed = True
        if self._process is not None:
            self._process.kill()


_own = threading.local()


def own_helper() -> Helper:
    """The helper of the calling thread."""
    if not hasattr(_own, "helper"):
        _own.helper = Helper()
    helper: Helper = _own.helper
    return helper


def analyse_content(content: bytes, name: str, options: dict[str, Any]) -> dict[str, Any]:
    """An outcome from the bytes of a recording: what a cluster's worker runs, with no file system shared."""
    with tempfile.TemporaryDirectory(prefix="invid-batch-") as folder:
        path = Path(folder) / f"recording{Path(name).suffix}"
        path.write_bytes(content)
        return asdict(own_helper().ask(path, name, Options.from_json(options)))


def main() -> None:
    """Answer tasks until stdin closes."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin.buffer:
            tasks.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        task = json.loads(tasks.get())
        outcome = analyse_recording(Path(task["path"]), task["name"], Options.from_json(task["options"]))
        answers.write(json.dumps(asdict(outcome)).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    main()
