"""What a runner keeps in its folder for the service that starts next: its lock, its last words, its rows."""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import signal
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from invid.errors import InputError, RecordingError
from invid.model.document import parse_json, save_text
from invid.recording.spool import SUFFIX, has_rows, is_spool
from invid.recording.writer import put_in_place
from invid.wording.sentence import joined, sentence, with_wording
from invid_drivers.protocol import AxisStates, LastSeen
from invid_service.jobs.states import State
from invid_service.store.blobs import KINDS
from invid_service.store.store import RunRecord
from invid_service.words import LOOK, UNSEEN, error_of

log = logging.getLogger(__name__)
_LOCK, _WORDS = "runner.pid", "last-words.json"


def hold(folder: Path) -> IO[str]:
    """Lock the folder for a runner; the lock lasts as long as its process, however that ends."""
    file = (folder / _LOCK).open("w")
    fcntl.flock(file, fcntl.LOCK_EX)
    file.write(str(os.getpid()))
    file.flush()
    return file


def settle(work: Path, grace_s: float) -> None:
    """Wait until every runner of the last service has stopped its drives and ended; kill what hangs: no run
    may start while one may still move its robot.

    A runner stops by itself when the pipe to its service breaks; killed, it leaves its drives without the
    master's heartbeat, and they stop by themselves.
    """
    deadline = time.monotonic() + grace_s
    for path in sorted(work.glob(f"*/{_LOCK}")):
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


@dataclass(frozen=True)
class LastWords:
    """States of the axes as they were told last, and how the motion ended; empty: nobody has said."""

    axes: AxisStates = field(default_factory=AxisStates)
    end: str = ""

    def write(self, folder: Path) -> None:
        """Leave them in the folder of the run; a disk that takes no more keeps nobody from stopping."""
        with contextlib.suppress(InputError):
            save_text(folder / _WORDS, json.dumps(with_wording(asdict(self))))

    @classmethod
    def read(cls, folder: Path) -> LastWords:
        """Those that were left in a folder; none where there are none."""
        try:
            found = parse_json((folder / _WORDS).read_text(encoding="utf-8"))
            return cls(AxisStates(tuple(LastSeen(**a) for a in found["axes"]["axes"])), found["end"])
        except (OSError, ValueError, TypeError, KeyError):
            return cls()


def unseen(
    error: dict[str, Any], states: AxisStates, names: Sequence[str], known: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the error of a run whose axes nobody has seen at rest, with what is known of them."""
    axes = states.of(names)
    more = [sentence("{text}.", text=text) for text in (*(a.sentence for a in axes), *known)]
    what = joined([error["text"], sentence(UNSEEN)], " ")
    look = {"text": joined([what, *more], " "), "what": what, "fix": sentence(LOOK)}
    return {**error, **look, "axes": [asdict(a) for a in axes], "known": list(known)}


def interruption(run: RunRecord, words: LastWords) -> dict[str, Any]:
    """Return the error of a run that the end of its service cut off, by what its runner left."""
    error = error_of("interrupted", state=str(run.state))
    if run.state is State.RUNNING and words.end:
        end = sentence("Its motion was ended: {end}", end=words.end)
        return {**error, "text": joined([error["text"], end], " "), "known": [end]}
    if run.state is State.RUNNING and not run.simulated:
        return unseen(error, words.axes, run.axes)
    return error


def complete_recording(folder: Path) -> None:
    """Make a recording of the rows that a killed runner measured.

    OSError where the disk does not take it: the rows then stay in the folder.
    """
    target = folder / KINDS["recording"][0]
    rows = target.with_name(target.name + SUFFIX)
    if target.exists() or not is_spool(rows) or not has_rows(rows):
        return
    try:
        put_in_place(rows, target)
    except RecordingError as error:
        log.error("run %s: what it measured cannot be read: %s", folder.name, error)
