"""kill -9 at a random instant of a measurement: what was measured is there, readable and marked.

Victims: the runner of ``invid serve``; the service; both at once, as a power cut ends them; ``invid measure``
on the command line. The instant is any from the first rows on the disk to some seconds into the analysis.
Afterwards the recording opens, holds every row that was on the disk, and its ``outcome`` says how it ended;
the service offers it, has every run in its store, and works it out or says why not.
"""

import contextlib
import hashlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from service_process import ENDED, SMALL_CELL, Serving, serving

from invid.errors import InvidError
from invid.recording import Outcome, Recording, read_recording
from invid.recording.spool import has_rows, is_spool

pytestmark = pytest.mark.service

CELL = SMALL_CELL.replace("periods: 3", "periods: 12").replace("periods: 2,", "periods: 8,")
"""Forty seconds of record: some five of a quiet machine in virtual time."""
WINDOW_S = 5.0
"""After the first rows."""
INVID = [sys.executable, "-c", "from invid.cli import main; main()"]


def moment(victim: str) -> float:
    """One instant for each victim."""
    return random.Random(victim).uniform(0.0, WINDOW_S)


def is_consistent(folder: Path) -> None:
    """A store that nobody has open is whole, and so are its files."""
    with contextlib.closing(sqlite3.connect(folder / "data" / "store.sqlite")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert not database.execute("PRAGMA foreign_key_check").fetchall()
        for path, sha256 in database.execute("SELECT path, sha256 FROM artefacts WHERE deleted IS NULL"):
            content = (folder / "data" / "files" / path).read_bytes()
            assert hashlib.sha256(content).hexdigest() == sha256, path


def until_rows(rows: Path, alive: Callable[[], bool], seconds: float = 600.0) -> None:
    """Wait until rows are on the disk."""
    end = time.monotonic() + seconds
    while not (is_spool(rows) and has_rows(rows)):
        assert time.monotonic() < end, rows
        assert alive(), rows
        time.sleep(0.01)


def count(recording: Recording) -> int:
    """Rows of all experiments."""
    return sum(e.samples for e in recording.experiments)


def on_disk(rows: Path) -> int:
    """Rows that were on the disk by now; 0 where the recording has been closed."""
    try:
        return count(read_recording(rows))
    except InvidError:
        return 0


def is_worked_out(service: Serving, location: str) -> None:
    """The analysis makes something of what is left, or says why not."""
    answer = service.client.post(f"{location}/analysis")
    end = time.monotonic() + 600.0
    while (body := service.client.get(answer.headers["Location"]).json())["state"] not in ENDED:
        assert time.monotonic() < end, body
        time.sleep(0.2)
    if body["state"] == "succeeded":
        assert body["summary"]["verdict"]
    else:
        assert body["state"] == "failed"
        assert body["error"]["text"]
        assert body["error"]["code"] not in ("internal-error", "runner-died")


BY_NIGHT = pytest.mark.campaign
"""What a kill of one of the two ends is in `make test` by ``test_service_runs.py``, and of the command by
``test_two_processes.py``."""


@pytest.mark.parametrize(
    "victim", [pytest.param("runner", marks=BY_NIGHT), pytest.param("service", marks=BY_NIGHT), "both"]
)
def test_a_kill_at_a_random_instant_leaves_a_readable_recording_that_is_offered_and_worked_out(
    tmp_path: Path, victim: str
) -> None:
    with serving(tmp_path, cell=CELL) as service:
        location = service.start()
        rows = tmp_path / "data" / "work" / location.rsplit("/", 1)[1] / "recording.h5.rows"
        until_rows(rows, lambda: service.process.poll() is None)
        time.sleep(moment(victim))
        before = on_disk(rows)
        (runner,) = service.runners() or (0,)
        if victim == "both":
            os.kill(service.process.pid, signal.SIGSTOP)
        if victim in ("runner", "both") and runner:
            with contextlib.suppress(ProcessLookupError):
                os.kill(runner, signal.SIGKILL)
        if victim in ("service", "both"):
            service.kill()
        else:
            end = time.monotonic() + 60.0
            while service.client.get(location).json()["state"] not in {*ENDED, "awaiting_accept"}:
                assert time.monotonic() < end, "the service did not notice that its runner had gone"
                time.sleep(0.05)
    is_consistent(tmp_path)
    with serving(tmp_path, cell=CELL) as service:
        assert service.client.get(location).json()["state"] in ("interrupted", "failed", "awaiting_accept")
        answer = service.client.get(f"{location}/recording")
        assert answer.status_code == 200, answer.text
        (tmp_path / "fetched.h5").write_bytes(answer.content)
        recording = read_recording(tmp_path / "fetched.h5")
        assert count(recording) >= max(before, 1)
        assert recording.outcome in (Outcome.FAILED, Outcome.ABORTED, Outcome.COMPLETED)
        is_worked_out(service, location)


@BY_NIGHT
def test_a_killed_command_leaves_rows_that_identify_reads(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(CELL)
    out, rows = tmp_path / "r.h5", tmp_path / "r.h5.rows"
    with (tmp_path / "measure.txt").open("w") as said:
        command = [*INVID, "measure", "cell.yaml", "-o", "r.h5"]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=said, stderr=said)
    until_rows(rows, lambda: process.poll() is None)
    time.sleep(moment("command"))
    before = on_disk(rows)
    process.kill()
    process.wait()
    left = out if out.exists() else rows
    recording = read_recording(left)
    assert count(recording) >= max(before, 1)
    closed = out.exists() and h5py.is_hdf5(out)
    assert recording.outcome is (Outcome.COMPLETED if closed else Outcome.FAILED)
    command = [*INVID, "identify", left.name, "-o", "m.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 2, 3), done.stderr
    assert "Traceback" not in done.stderr
